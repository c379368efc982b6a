"""Are the tests and intervals that tables print what they promise: simulated where the truth is known.

    python -m benchmarks.evidence                  (some minutes; --trials and --sweeps for more)

Type-I error: how often a test calls a difference, or an equivalence, that is not there. Coverage: how often an interval
holds the truth. Both on the landscape of `benchmarks.landscape`, where networks of one place do not differ at all.
Power of whole searches against their controls: `benchmarks.evidence_power`.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import binomtest

from analysis.statistics.effects import Interval, effects, effects_of_constant, median, superiority
from analysis.statistics.equivalence import equivalence
from analysis.statistics.noise import icc
from analysis.statistics.planning import CONFIDENCE, pooled
from analysis.statistics.tests import holm, hypergeometric_p, mann_whitney
from benchmarks import evidence_images
from benchmarks.evidence_power import power_table
from benchmarks.landscape import BASELINE, Floats, Landscape, Searched, Strategy, search
from tacevo.evolution.archive import Tessellation, find_centroids, qd_score

ALPHA = 0.05

#: In parts of the baseline's median, as conf/study.yaml has it.
MARGIN = 0.1

#: Of a bootstrap here: fewer than a table's 9,999, for speed; the ends are rougher by a tenth of their own error.
_RESAMPLES = 399

Trial = Callable[[np.random.Generator], bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """How often something happened that should not, or should."""

    name: str
    #: In [0, 1].
    observed: float
    trials: int
    #: What was promised of the rate: 0.05 at most, 0.95 at least.
    promised: float

    @property
    def error(self) -> float:
        """Three standard errors of a rate as promised: what a simulation may miss by chance."""
        return 3 * float(np.sqrt(self.promised * (1 - self.promised) / self.trials))


def type_one_errors(trials: int, seed: int = 0) -> Iterator[Rate]:
    """Measure how often each test finds what is not there, at a level of 5 %."""
    for name, trial in {**_FALSE, **evidence_images.FALSE}.items():
        yield _rate(name, trial, trials, seed, promised=ALPHA)


def coverages(trials: int, seed: int = 0) -> Iterator[Rate]:
    """Measure how often each 95 % interval holds the truth, and the upper limit of a pilot's spread, of 80 %."""
    for name, trial in {**_COVERED, **evidence_images.COVERED}.items():
        yield _rate(name, trial, trials, seed, promised=1 - ALPHA)
    for name, trial in _LIMITED.items():
        yield _rate(name, trial, trials, seed, promised=CONFIDENCE)


def _rate(name: str, trial: Trial, trials: int, seed: int, *, promised: float) -> Rate:
    rng = np.random.default_rng([seed, *name.encode()])
    return Rate(name=name, observed=sum(trial(rng) for _ in range(trials)) / trials, trials=trials, promised=promised)


def _alike(rng: np.random.Generator, networks: int, seeds: int, noise: float = 0.3) -> Floats:
    """Train networks of one place, which do not differ."""
    return Landscape(signal=1.0, noise=noise).train(np.tile(BASELINE, (networks, 1)), seeds, rng)


def _differs(seeds: int, variants: int = 1) -> Trial:
    """Call any of some variants different from the baseline, after Holm."""
    return lambda rng: _any_differs(_alike(rng, variants + 1, seeds))


def _any_differs(samples: Floats) -> bool:
    return min(holm([mann_whitney(sample, samples[0]).p for sample in samples[1:]])) <= ALPHA


def _differs_in_accuracy(rng: np.random.Generator) -> bool:
    """The same of accuracies, most of which tie."""
    return _any_differs(rng.binomial(56, 0.9, size=(5, 20)) / 56)


def _differs_on_an_output(rng: np.random.Generator) -> bool:
    """Call any of four variants different on any of three outputs that share most of their noise."""
    shared = _alike(rng, 5, 20)
    outputs = [shared * np.exp(0.1 * rng.normal(size=(5, 20))) for _ in range(3)]
    return min(holm([mann_whitney(x, each[0]).p for each in outputs for x in each[1:]])) <= ALPHA


def _differs_in_spread(rng: np.random.Generator) -> bool:
    """Call two networks of one median different, of which one spreads four times as far: not what the test asks."""
    return mann_whitney(rng.normal(size=20), 4 * rng.normal(size=20)).p <= ALPHA


def _equals(*, known: bool, variants: int) -> Trial:
    """Call any of some variants equivalent, all of which are worse by just the margin.

    Args:
        known: whether the margin is that of the true median; otherwise it is a part of the median that was found.
        variants: how many.
    """

    def trial(rng: np.random.Generator) -> bool:
        samples = 1.0 + 0.05 * rng.normal(size=(variants + 1, 20))
        samples[1:] += MARGIN
        margin = MARGIN if known else MARGIN * float(np.median(samples[0]))
        return min(holm([equivalence(sample, samples[0], margin=margin).p for sample in samples[1:]])) <= ALPHA

    return trial


def _motif_is_called_typical(rng: np.random.Generator) -> bool:
    """Call any of six motifs more frequent among the best ten of 200 networks."""
    marked = rng.random((6, 200)) < rng.uniform(0.05, 0.6, size=(6, 1))
    found = [hypergeometric_p(int(row[:10].sum()), drawn=10, marked=int(row.sum()), population=200) for row in marked]
    return min(holm(found)) <= ALPHA


def chosen_differs(rng: np.random.Generator, *, fresh: bool) -> bool:
    """Choose the best of 20 networks that do not differ by 20 seeds each, and call it different from the baseline.

    Args:
        rng: of the noise.
        fresh: whether the study has seeds of its own, as ours has; otherwise it trains on those that chose.
    """
    losses = _alike(rng, 21, 20)
    best = 1 + int(np.median(losses[1:], axis=1).argmin())
    studied = _alike(rng, 2, 20) if fresh else losses[[0, best]]
    return _any_differs(studied)


def _holds(found: Interval | None, truth: float) -> bool:
    return found is not None and found.low <= truth <= found.high


def _median_difference_covered(seeds: int) -> Trial:
    """Cover the distance of two normal samples of which one is larger with a chance of 0.8."""
    shift = float(np.sqrt(2) * ndtri(0.8))

    def trial(rng: np.random.Generator) -> bool:
        found = effects(rng.normal(shift, size=seeds), rng.normal(size=seeds), rng=rng, resamples=_RESAMPLES)
        return _holds(found.median_difference, shift)

    return trial


def _a12_covered(chance: float, seeds: int, spread: float = 1.0) -> Trial:
    """Cover A12, the chance that one seed is lower than another, whose deviation is `spread` times as large."""
    shift = float(np.sqrt(1 + spread**2) * ndtri(chance))
    return lambda rng: _holds(superiority(rng.normal(size=seeds), shift + spread * rng.normal(size=seeds)), chance)


def _constant_covered(chance: float, seeds: int) -> Trial:
    """Cover the chance that a seed is lower than a value that has none."""
    return lambda rng: _holds(effects_of_constant(ndtri(chance), rng.normal(size=seeds)).a12, chance)


def _median_covered(seeds: int) -> Trial:
    return lambda rng: _holds(median(rng.normal(size=seeds)), 0.0)


def _icc_covered(part: float, networks: int, seeds: int) -> Trial:
    """Cover the part of the variance that is the networks', of losses whose logarithms are normal."""

    def trial(rng: np.random.Generator) -> bool:
        levels = np.sqrt(part) * rng.normal(size=(networks, 1))
        return _holds(icc(np.exp(levels + np.sqrt(1 - part) * rng.normal(size=(networks, seeds)))), part)

    return trial


def _rate_covered(rng: np.random.Generator) -> bool:
    ends = binomtest(int(rng.binomial(30, 0.2)), 30).proportion_ci(1 - ALPHA, method="wilson")
    return bool(ends.low <= 0.2 <= ends.high)


def _spread_limited(samples: int, values: int) -> Trial:
    """Keep the true deviation, 1, below the upper limit of what so many samples of so many values estimate."""

    def trial(rng: np.random.Generator) -> bool:
        found = pooled(list(rng.normal(size=(samples, values))))
        return found is not None and found.upper >= 1

    return trial


_FALSE: dict[str, Trial] = {
    "Mann-Whitney, 4 seeds": _differs(4),
    "Mann-Whitney, 5 seeds": _differs(5),
    "Mann-Whitney, 20 seeds": _differs(20),
    "Mann-Whitney, 40 seeds (normal)": _differs(40),
    "Holm, 4 variants": _differs(20, variants=4),
    "Holm, 4 variants, tied accuracies": _differs_in_accuracy,
    "Holm, 4 variants on 3 outputs": _differs_on_an_output,
    "Mann-Whitney, spreads 1 to 4": _differs_in_spread,
    "equivalence, margin stated": _equals(known=True, variants=1),
    "equivalence, margin a part of the baseline's median": _equals(known=False, variants=1),
    "equivalence, Holm, 4 variants": _equals(known=True, variants=4),
    "hypergeometric, Holm, 6 motifs": _motif_is_called_typical,
    "elites chosen by a noise run, own seeds": lambda rng: chosen_differs(rng, fresh=True),
}

_COVERED: dict[str, Trial] = {
    "difference of medians, 5 seeds, bootstrap": _median_difference_covered(5),
    "difference of medians, 20 seeds, bootstrap": _median_difference_covered(20),
    "median, 7 seeds, sign test": _median_covered(7),
    "median, 20 seeds, sign test": _median_covered(20),
    "A12 of 0.5, 5 seeds": _a12_covered(0.5, 5),
    "A12 of 0.5, 20 seeds": _a12_covered(0.5, 20),
    "A12 of 0.8, 5 seeds": _a12_covered(0.8, 5),
    "A12 of 0.95, 5 seeds": _a12_covered(0.95, 5),
    "A12 of 0.95, 20 seeds": _a12_covered(0.95, 20),
    "A12 of 0.5, 20 seeds, spreads 1 to 4": _a12_covered(0.5, 20, spread=4.0),
    "A12 of 0.8, of a constant, 20 seeds": _constant_covered(0.8, 20),
    "ICC of 0.2, 5 networks, 20 seeds": _icc_covered(0.2, 5, 20),
    "ICC of 0.64, 5 networks, 20 seeds": _icc_covered(0.64, 5, 20),
    "ICC of 0.2, 20 networks, 5 seeds": _icc_covered(0.2, 20, 5),
    "rate of 0.2, 30 trials, Wilson": _rate_covered,
}

_LIMITED: dict[str, Trial] = {
    "upper limit of a spread, 2 arms of 3 jobs, Browne": _spread_limited(2, 3),
    "upper limit of a spread, 5 networks of 20 seeds, Browne": _spread_limited(5, 20),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Medians over some searches of one strategy; improvements are parts of the baseline's loss, in (-inf, 1]."""

    #: By recorded fitness, of which each is one draw.
    recorded: float
    #: By the median of five other seeds of the same two networks.
    reestimated: float
    #: By the truth.
    true: float
    #: QD-score of the last archive by what the search knew, and by the truth.
    qd_recorded: float
    qd_true: float
    #: Part of the searches in which Newcombe's interval, of 20 other seeds, holds the best network's true chance to
    #: beat the baseline.
    covered: float


def searches(landscape: Landscape, strategy: Strategy, *, runs: int, trainings: int) -> Outcome:
    """Search the landscape some times, and compare what was recorded with the truth.

    Args:
        landscape: the truth.
        strategy: of the parents.
        runs: searches, each with draws of its own.
        trainings: of each.
    """
    niches = Tessellation(find_centroids(niches=25, dimensions=2, samples=2_000, seed=0))
    found = []
    for number in range(runs):
        rng = np.random.default_rng([number, *strategy.encode()])
        found.append(_outcome(landscape, search(landscape, strategy, niches, trainings, number), rng))
    *medians, covered = zip(*found, strict=True)
    recorded, reestimated, true, qd_recorded, qd_true = (float(np.median(values)) for values in medians)
    return Outcome(
        recorded=recorded,
        reestimated=reestimated,
        true=true,
        qd_recorded=qd_recorded,
        qd_true=qd_true,
        covered=float(np.mean(covered)),
    )


def _outcome(landscape: Landscape, found: Searched, rng: np.random.Generator) -> tuple[float, ...]:
    pair = found.points[[found.best, 0]]
    best, baseline = landscape.truth(pair)
    again = landscape.train(pair, 20, rng)
    few = np.median(again[:, :5], axis=1)
    chance = float(ndtr(np.log(baseline / best) / (landscape.noise * np.sqrt(2)))) if landscape.noise else 1.0
    held = found.points[[int(elite.name) for elite in found.archive.elites.values()]]
    return (
        _improvement(found.fitness[found.best], found.fitness[0]),
        _improvement(few[0], few[1]),
        _improvement(best, baseline),
        qd_score(found.archive),
        float((1 / (1 + landscape.truth(held))).sum()),
        _holds(superiority(*again), chance),
    )


def _improvement(best: float, baseline: float) -> float:
    return float((baseline - best) / baseline)


def _table(title: str, rates: Iterator[Rate]) -> Iterator[str]:
    yield f"| {title} | observed | promised | +- by chance |"
    yield "|---|---|---|---|"
    for rate in rates:
        yield f"| {rate.name} | {rate.observed:.3f} | {rate.promised:.2f} | {rate.error:.3f} |"
    yield ""


def _searches_table(runs: int, trainings: int) -> Iterator[str]:
    yield (
        "| signal | noise | parents | improvement, recorded | re-estimated | true | interval holds the truth "
        "| QD-score, recorded | true |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for signal, noise in ((0.0, 0.3), (1.0, 0.1), (1.0, 0.6)):
        for strategy in Strategy:
            one = searches(Landscape(signal=signal, noise=noise), strategy, runs=runs, trainings=trainings)
            figures = f"{one.recorded:.0%} | {one.reestimated:.0%} | {one.true:.0%} | {one.covered:.0%}"
            archive = f"{one.qd_recorded:.2f} | {one.qd_true:.2f}"
            yield f"| {signal:g} | {noise:g} | {strategy} | {figures} | {archive} |"
    yield ""


#: Of the landscape's seeds, for the table of power.
_NOISES = (0.1, 0.3, 0.6)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=2_000, help="of each rate (2000)")
    parser.add_argument("--runs", type=int, default=40, help="searches of each kind (40)")
    parser.add_argument("--trainings", type=int, default=200, help="of each search (200)")
    parser.add_argument("--sweeps", type=int, default=20, help="simulated sweeps of each noise (20)")
    parser.add_argument("--jobs", type=int, nargs="+", default=[5, 10], help="of each arm of these (5 10)")
    options = parser.parse_args(arguments)
    for lines in (
        _table("test", type_one_errors(options.trials)),
        _table("interval", coverages(options.trials)),
        _searches_table(options.runs, options.trainings),
        power_table(_NOISES, sweeps=options.sweeps, jobs=options.jobs, trainings=options.trainings),
    ):
        for line in lines:
            print(line, flush=True)


if __name__ == "__main__":
    main()
