"""What a fitness is worth: the noise of its training seed, by the same networks under other seeds. Pure.

A fitness is one draw. Re-estimates are further draws of the same network: the same training under other seeds. All
values are losses: lower is better.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f, kendalltau

from analysis.statistics.effects import LEVEL, Interval, superiority
from analysis.statistics.samples import Sample
from tacevo.rounding import rounded


@dataclass(frozen=True, slots=True, kw_only=True)
class Draws:
    """The recorded fitness of some networks, and what other seeds give; the first network is the reference."""

    #: Shape (n,), n >= 1.
    recorded: Sample
    #: Shape (n, S), S >= 1.
    estimates: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            ValueError: they do not suit each other, or a value is NaN or infinite.
        """
        shapes = self.recorded.shape, self.estimates.shape
        if self.estimates.ndim != 2 or not self.estimates.size or shapes[0] != shapes[1][:1]:
            raise ValueError(f"expected a fitness for each of n networks, and n x S re-estimates; got shapes {shapes}")
        if not (np.isfinite(self.recorded).all() and np.isfinite(self.estimates).all()):
            raise ValueError("expected finite losses; got NaN or infinity; drop or rerun those seeds first")


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkNoise:
    """One network's fitness beside its re-estimates."""

    recorded: float
    #: Of the re-estimates.
    median: float
    least: float
    most: float
    #: Re-estimates that are as low as the recorded fitness, or lower.
    as_low: int
    #: Recorded less median: below 0 where the record flatters the network.
    optimism: float
    #: The re-estimate to expect of this recorded fitness, see `expected`; None without an ICC.
    expected: float | None
    #: Chance that one seed of the network is better than one seed of the reference; None of the reference itself.
    beats: Interval | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """What re-estimates say of recorded fitnesses."""

    #: S, re-estimates of each network.
    seeds: int
    #: In the order given; the reference first.
    networks: tuple[NetworkNoise, ...]
    #: Part of the variance of one fitness that is the network's, see `icc`; None where it is not defined.
    icc: Interval | None
    #: Kendall's tau of the recorded fitnesses and the medians of the re-estimates, see `agreement`.
    agreement: float | None


def noise(draws: Draws) -> Noise:
    """Compare every recorded fitness with the re-estimates of its network."""
    medians, found = np.median(draws.estimates, axis=1), icc(draws.estimates)
    reference, *others = draws.estimates
    beats = [None, *(superiority(values, reference) for values in others)]
    return Noise(
        seeds=draws.estimates.shape[1],
        networks=tuple(
            NetworkNoise(
                recorded=float(recorded),
                median=rounded(float(median)),
                least=float(values.min()),
                most=float(values.max()),
                as_low=int((values <= recorded).sum()),
                optimism=rounded(float(recorded - median)),
                expected=None if found is None else expected(float(recorded), draws.estimates, found.estimate),
                beats=chance,
            )
            for recorded, median, values, chance in zip(draws.recorded, medians, draws.estimates, beats, strict=True)
        ),
        icc=found,
        agreement=agreement(draws.recorded, medians),
    )


def icc(estimates: ArrayLike) -> Interval | None:
    """Estimate ICC(1): the part of the variance of one training's loss that lies between networks.

    With the mean squares MSB between networks and MSW within them it is (MSB - MSW) / (MSB + (S - 1) MSW), and its
    interval the exact one of normal values (Shrout and Fleiss 1979, Psychological Bulletin 86: 420-428, equation 1;
    McGraw and Wong 1996, Psychological Methods 1: 30-46, table 7). It is computed of the losses' logarithms, because a
    loss spreads in proportion to its size, and its logarithm is nearer to a normal value. It can lie below 0.

    Args:
        estimates: losses of n networks under S seeds each, shape (n, S).

    Returns:
        None where it is not defined: one network, one seed, no variance at all, or a loss that is not above 0.
    """
    losses = np.asarray(estimates, dtype=np.float64)
    networks, seeds = losses.shape
    if networks < 2 or seeds < 2 or losses.min() <= 0 or np.ptp(losses) == 0:
        return None
    logs = np.log(losses)
    between = seeds * float(logs.mean(axis=1).var(ddof=1))
    within = float(logs.var(axis=1, ddof=1).mean())
    if within == 0:
        return Interval(estimate=1.0, low=1.0, high=1.0) if between > 0 else None
    ratio, tail = between / within, (1 + LEVEL) / 2
    free = networks - 1, networks * (seeds - 1)
    low, high = ratio / float(f.ppf(tail, *free)), ratio * float(f.ppf(tail, *reversed(free)))
    estimate, least, most = ((value - 1) / (value + seeds - 1) for value in (ratio, low, high))
    return Interval(estimate=rounded(estimate), low=rounded(least), high=rounded(most))


def expected(recorded: float, estimates: ArrayLike, reliability: float) -> float | None:
    """Return the loss to expect of a network under another seed, given its recorded one: regression to the mean.

    The logarithm moves to the mean of all re-estimates by 1 - ICC of its distance (Kelley 1927). Networks that were
    chosen by their fitness vary less than all of a search, so mean and ICC are those of the networks at hand.

    Args:
        recorded: the fitness.
        estimates: losses above 0 of all networks, shape (n, S).
        reliability: the ICC; one below 0 counts as 0.

    Returns:
        A loss, or None where the recorded one has no logarithm.
    """
    if recorded <= 0:
        return None
    mean = float(np.log(np.asarray(estimates, dtype=np.float64)).mean())
    return rounded(float(np.exp(mean + max(reliability, 0.0) * (np.log(recorded) - mean))))


def agreement(x: ArrayLike, y: ArrayLike) -> float | None:
    """Return Kendall's tau-b of two rankings of the same networks, in [-1, 1].

    Returns:
        None where there is nothing to rank: fewer than two networks, or all of them equal on one side.
    """
    first, second = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(first) < 2 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return None
    return rounded(float(kendalltau(first, second).statistic))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranking:
    """How a fitness taken at an epoch ranks the networks, beside their test scores under other seeds."""

    epoch: int
    #: Tau of one seed's fitnesses, mean over the seeds; None where no seed has a tau.
    one_seed: float | None
    #: Tau of the medians over these seeds.
    median: float | None


def rankings(losses: ArrayLike, scores: ArrayLike) -> tuple[Ranking, ...]:
    """Compare the ranks by fitness at every epoch with those by test score.

    Each side has seeds of its own: the first, third ... seed give the fitness, the others the test score. Otherwise
    one training would stand on both sides, and its luck would pass for agreement.

    Args:
        losses: validation losses of n networks, S >= 2 seeds and E epochs, shape (n, S, E).
        scores: test scores of the weights of the best validation epoch, lower is better, shape (n, S).

    Returns:
        One for each epoch; none of one seed, which cannot be divided.
    """
    by_epoch, tested = np.asarray(losses, dtype=np.float64), np.asarray(scores, dtype=np.float64)
    if tested.shape[1] < 2:
        return ()
    fitness, final = by_epoch[:, ::2], np.median(tested[:, 1::2], axis=1)
    found = []
    for epoch in range(by_epoch.shape[2]):
        each = [agreement(fitness[:, seed, epoch], final) for seed in range(fitness.shape[1])]
        known = [tau for tau in each if tau is not None]
        found.append(
            Ranking(
                epoch=epoch + 1,
                one_seed=rounded(float(np.mean(known))) if known else None,
                median=agreement(np.median(fitness[:, :, epoch], axis=1), final),
            )
        )
    return tuple(found)
