"""Can a sweep tell a search from its controls: sweeps of searches of a landscape, compared as `tacevo ablations` does.

Each job searches the landscape; the network of its best record is trained again with fresh seeds, and the median of
these losses is its one value. Arms of one seed share what the arms of a sweep share. `benchmarks.evidence` prints this.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.stats import binomtest

from analysis.sweeps.ablation import ALPHA, as_jobs, compare_arms
from analysis.sweeps.metrics import Metric
from benchmarks.landscape import Landscape, Strategy, search
from tacevo.evolution.archive import Tessellation, find_centroids
from tacevo.results.sweep import REFERENCE
from tacevo.storage.canonical import content_hash

#: The controls, by the names of their arms.
CONTROLS = {
    "drift": Strategy.drift,
    "best_k": Strategy.best_k,
    "random_sampling": Strategy.random,
    "regularised_evolution": Strategy.regularised_evolution,
    "random_parents_only_baseline": Strategy.baseline,
}

#: The search against itself, as the jobs of such an arm would be: with the reference's seeds, so that generation 0 is
#: one, and with other seeds.
SAME_SEEDS, OTHER_SEEDS = "none again, the same seeds", "none again, other seeds"

#: Arms that are corrected together.
FAMILIES = (tuple(CONTROLS), (SAME_SEEDS,), (OTHER_SEEDS,))

#: Fresh training seeds of what a job found.
RETRAININGS = 5

#: A metric of a sweep, as its table is called for: test scores, or the best record.
METRICS = {"test score": Metric.test_mse, "best fitness": Metric.best_fitness}


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """How often sweeps of one size found the arm to differ from the search, after Holm's correction."""

    arm: str
    #: Of each arm.
    jobs: int
    #: Key of `METRICS`.
    metric: str
    sweeps: int
    #: Sweeps in which the arm was found to be worse than the search, and better.
    worse: int
    better: int

    @property
    def bound(self) -> float:
        """The most of a rate of 5 % that so many sweeps show by chance: three standard errors above."""
        return ALPHA + 3 * float(np.sqrt(ALPHA * (1 - ALPHA) / self.sweeps))


def told(
    landscape: Landscape,
    *,
    sweeps: int,
    jobs: Sequence[int],
    trainings: int,
    families: Sequence[tuple[str, ...]] = FAMILIES,
) -> list[Told]:
    """Run sweeps of a search, its controls and itself, and compare their arms.

    The search against itself is a family of its own, of one arm; so a rate above 5 % would be an error of the test.

    Args:
        landscape: the truth.
        sweeps: each has seeds of its own.
        jobs: of each arm; a smaller sweep is the first jobs of a larger one.
        trainings: of each search.
        families: the arms beside the search.
    """
    niches = Tessellation(find_centroids(niches=25, dimensions=2, samples=2_000, seed=0))
    counts: dict[tuple[str, int, str], list[int]] = {}
    most = max(jobs)
    for sweep in range(sweeps):
        seeds = range(sweep * most, (sweep + 1) * most)
        arms = {
            name: [_outcome(landscape, niches, trainings, name, seed, at=seed - seeds[0]) for seed in seeds]
            for name in (REFERENCE, *chain.from_iterable(families))
        }
        for number in jobs:
            for family in families:
                for key, ways in _compared(arms, family, number).items():
                    known = counts.setdefault(key, [0, 0])
                    known[0], known[1] = known[0] + ways[0], known[1] + ways[1]
    return [
        Told(arm=arm, jobs=number, metric=metric, sweeps=sweeps, worse=worse, better=better)
        for (arm, number, metric), (worse, better) in counts.items()
    ]


def _outcome(
    landscape: Landscape, niches: Tessellation, trainings: int, arm: str, seed: int, *, at: int
) -> dict[str, object]:
    """Run a job, and test what it found; return it as a row of a frame of jobs."""
    own = -1 - seed if arm == OTHER_SEEDS else seed
    strategy = CONTROLS.get(arm, Strategy.elites)
    found = search(landscape, strategy, niches, trainings, own, another=int(arm == SAME_SEEDS))
    fresh = landscape.evaluate(found.points[found.best], own, range(1_000, 1_000 + RETRAININGS))
    return {
        "job": f"{arm}-seed{at}",
        "arm": arm,
        "seed": at,
        "search": content_hash(found.points.tolist()),
        "test_mse": float(np.median(fresh)),
        "best_fitness": float(found.fitness.min()),
    }


def _compared(
    arms: Mapping[str, Sequence[Mapping[str, object]]], family: Sequence[str], jobs: int
) -> dict[tuple[str, int, str], tuple[bool, bool]]:
    """Compare arms with the reference as a sweep does; return whether each was found worse, and better."""
    rows = [one for name in (REFERENCE, *family) for one in arms[name][:jobs]]
    found = compare_arms(as_jobs(rows), wanted=REFERENCE)
    return {
        (row.Index, jobs, name): (row.p_holm <= ALPHA and row.a12 > 0.5, row.p_holm <= ALPHA and not row.a12 > 0.5)
        for name, metric in METRICS.items()
        for row in found.arms[metric].iloc[1:].itertuples()
    }


def power_table(noises: Sequence[float], *, sweeps: int, jobs: Sequence[int], trainings: int) -> Iterator[str]:
    """Write, for each noise and arm, how often sweeps of each size told the arm from the search."""
    yield f"{sweeps} sweeps of each noise, {trainings} trainings a job; jobs are tested with {RETRAININGS} fresh seeds."
    yield "In per cent of the sweeps: the arm was found worse / better than the search, at 5 % after Holm."
    yield f"In brackets Wilson's 95 % interval of either; a true 5 % shows at most {_most(sweeps):.0f} by chance."
    yield ""
    sizes = [(metric, number) for metric in METRICS for number in jobs]
    yield f"| noise | arm | {' | '.join(f'{metric}, {number} jobs' for metric, number in sizes)} |"
    yield "|---" * (2 + len(sizes)) + "|"
    for noise in noises:
        rates = told(Landscape(signal=1.0, noise=noise), sweeps=sweeps, jobs=jobs, trainings=trainings)
        cells = {(one.arm, one.metric, one.jobs): _cell(one) for one in rates}
        for arm in dict.fromkeys(one.arm for one in rates):
            yield f"| {noise:g} | {arm} | {' | '.join(cells[arm, metric, number] for metric, number in sizes)} |"
    yield ""


def _most(sweeps: int) -> float:
    return 100 * Told(arm="", jobs=0, metric="", sweeps=sweeps, worse=0, better=0).bound


def _cell(one: Told) -> str:
    low, high = binomtest(one.worse + one.better, one.sweeps).proportion_ci(0.95, method="wilson")
    return (
        f"{100 * one.worse / one.sweeps:.0f} / {100 * one.better / one.sweeps:.0f} [{100 * low:.0f}, {100 * high:.0f}]"
    )
