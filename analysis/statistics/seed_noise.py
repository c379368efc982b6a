"""The worth of a fitness: the noise of its training seed, by the same networks under other seeds. Pure.

A fitness is one draw. Re-estimates are further draws of the same network: the same training under other seeds. All
values are losses: lower is better.
"""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import f, kendalltau

from analysis.statistics.effects import LEVEL, superiority
from analysis.table import Interval
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.rounding import rounded

#: The columns of fitnesses beside their re-estimates, and the type of each, a network a row, the reference first. Of
#: the re-estimates: the median, the least, the most, and how many are as low as the record, or lower. `optimism` is
#: recorded less median: below 0 where the record flatters the network. `expected` is the re-estimate to expect of the
#: record; missing without an ICC. `beats` is the chance that one seed of the network is better than one of the
#: reference; missing of the reference itself.
NOISE = (
    dict.fromkeys(("recorded", "median", "least", "most"), "float64")
    | {"as_low": "int64"}
    | dict.fromkeys(("optimism", "expected", "beats", "beats_low", "beats_high"), "float64")
)

#: The columns of how a fitness taken at an epoch ranks the networks, beside their test scores under other seeds, and
#: the type of each: tau of one seed's fitnesses, mean over the seeds, and tau of their medians; missing where there is
#: none.
RANKINGS = {"epoch": "int64", "one_seed": "float64", "median": "float64"}

#: The columns of what a fitness is worth by each rule, and the type of each: the ICC of one training, missing where it
#: is not defined, and the taus of `RANKINGS`.
WORTH = {"rule": "str"} | dict.fromkeys(("icc", "icc_low", "icc_high", "one_seed", "median"), "float64")


def noise(recorded: ArrayLike, estimates: ArrayLike) -> pd.DataFrame:
    """Compare the recorded fitness of some networks with what other seeds give (`NOISE`).

    Args:
        recorded: shape (n,), n >= 1; the first network is the reference.
        estimates: shape (n, S), S >= 1.
    """
    records, draws = np.asarray(recorded, dtype=np.float64), np.asarray(estimates, dtype=np.float64)
    correlation, reference, rows = icc(draws), draws[0], []
    for number, (record, values) in enumerate(zip(records.tolist(), draws, strict=True)):
        median = float(np.median(values))
        row = {"recorded": record, "median": rounded(median), "least": values.min(), "most": values.max()}
        row |= {"as_low": (values <= record).sum(), "optimism": rounded(record - median)}
        row |= {"expected": None if correlation is None else expected(record, draws, correlation.estimate)}
        rows.append(row | (superiority(values, reference).columns("beats") if number else {}))
    return pd.DataFrame(rows, columns=list(NOISE)).astype(NOISE)


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
        return Interval(1.0, 1.0, 1.0) if between > 0 else None
    ratio, tail = between / within, (1 + LEVEL) / 2
    free = networks - 1, networks * (seeds - 1)
    low, high = ratio / float(f.ppf(tail, *free)), ratio * float(f.ppf(tail, *reversed(free)))
    return Interval(*(rounded((value - 1) / (value + seeds - 1)) for value in (ratio, low, high)))


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


def deviations(values: ArrayLike) -> tuple[float, float]:
    """Return the standard deviations between networks and between the seeds of one.

    They are those of a one-way analysis of variance; the first is 0 where the seeds' noise explains all.

    Args:
        values: for example logarithms of losses, of n >= 2 networks under S >= 2 seeds, shape (n, S).
    """
    known = np.asarray(values, dtype=np.float64)
    within = float(known.var(axis=1, ddof=1).mean())
    between = float(known.mean(axis=1).var(ddof=1)) - within / known.shape[1]
    return max(0.0, between) ** 0.5, within**0.5


def reliability(values: ArrayLike) -> float:
    """Return the part of the variance of networks' means that is networks' own, in [0, 1]; shapes as `deviations`."""
    (between, within), seeds = deviations(values), np.shape(values)[1]
    total = between**2 + within**2 / seeds
    return between**2 / total if total else 0.0


def shrunken(values: ArrayLike) -> NDArray[np.float64]:
    """Return the mean of each network, moved to the mean of all by the part that is seeds' (Kelley 1927).

    Args:
        values: shape (n, S), as `deviations`.

    Returns:
        Shape (n,).
    """
    means = np.asarray(values, dtype=np.float64).mean(axis=1)
    return np.asarray(means.mean() + reliability(values) * (means - means.mean()))


def agreement(x: ArrayLike, y: ArrayLike) -> float | None:
    """Return Kendall's tau-b of two rankings of the same networks, in [-1, 1].

    Returns:
        None where there is nothing to rank: fewer than two networks, or all of them equal on one side.
    """
    first, second = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(first) < 2 or first.min() == first.max() or second.min() == second.max():  # of infinite values, too
        return None
    return rounded(float(kendalltau(first, second).statistic))


def rankings(losses: ArrayLike, scores: ArrayLike) -> pd.DataFrame | None:
    """Compare the ranks by fitness at every epoch with those by test score.

    Each side has seeds of its own: the first, third ... seed give the fitness, the others the test score. Otherwise
    one training would stand on both sides, and its luck would pass for agreement.

    Args:
        losses: the fitness of n networks after so many epochs, S >= 2 seeds and E epochs, shape (n, S, E).
        scores: test scores of the weights of the best validation epoch, lower is better, shape (n, S).

    Returns:
        A row for each epoch (`RANKINGS`); None of one seed, which cannot be divided.
    """
    by_epoch, tested = np.asarray(losses, dtype=np.float64), np.asarray(scores, dtype=np.float64)
    if tested.shape[1] < 2:
        return None
    fitness, final = by_epoch[:, ::2], np.median(tested[:, 1::2], axis=1)
    rows = []
    for epoch in range(by_epoch.shape[2]):
        each = [agreement(fitness[:, seed, epoch], final) for seed in range(fitness.shape[1])]
        known = [tau for tau in each if tau is not None]
        one_seed = rounded(float(np.mean(known))) if known else None
        rows.append((epoch + 1, one_seed, agreement(np.median(fitness[:, :, epoch], axis=1), final)))
    return pd.DataFrame(rows, columns=list(RANKINGS)).astype(RANKINGS)


def worth(losses: ArrayLike, scores: ArrayLike) -> pd.DataFrame | None:
    """Compare what a fitness is worth by each rule after the last of some epochs; for the values see `rankings`.

    Returns:
        A row for each rule (`WORTH`); None of one seed.
    """
    curves = np.asarray(losses, dtype=np.float64)
    rows = []
    for name in FITNESS.ours:
        rule = of_settings(FITNESS, name, None)
        fitness = np.array([[rule.of(losses) for losses in network] for network in curves.tolist()])
        ranked, part = rankings(fitness[:, :, None], scores), icc(fitness)
        if ranked is None:
            return None
        taus = ranked.drop(columns="epoch").iloc[0].to_dict()
        rows.append({"rule": name} | taus | ({} if part is None else part.columns("icc")))
    return pd.DataFrame(rows, columns=list(WORTH)).astype(WORTH)
