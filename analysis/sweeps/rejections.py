"""The rates at which the tests of a sweep's arms reject: both samples of one arm, or of two arms. Pure.

Many searches of each arm, as the table of a space makes them cheap, are divided into small sweeps that share no search,
and each is compared as `tacevo ablations` compares it; jobs that failed are in none.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import product

import pandas as pd

from analysis.statistics.effects import proportion
from analysis.sweeps.ablation import corrected_p, samples_of
from analysis.sweeps.arm_metrics import Metric
from tacevo.results.sweep import ALPHA, REFERENCE

#: The columns of rates, and the type of each. Where `arm` is `against` itself, under other seeds, the rate is the size
#: of the test, which should be `ALPHA` at most; else its power. `rejected` of `sweeps` have p < `ALPHA` after Holm's
#: correction; what `tacevo ablations` does not test is not rejected. The interval is exact (`proportion`).
RATES = {"arm": "str", "against": "str", "metric": "str", "sweeps": "int64", "rejected": "int64"} | dict.fromkeys(
    ("rate", "rate_low", "rate_high"), "float64"
)


def rejection_rates(
    jobs: pd.DataFrame, *, seeds: int, requested_reference: str = REFERENCE, twins: Collection[str] = ()
) -> pd.DataFrame:
    """Return how often each test rejects at `ALPHA` with so many seeds an arm (`RATES`).

    Niches of `jobs` are those of the whole sweep. In a sweep arms share their seeds; two samples of one arm do not.

    Args:
        jobs: finished runs (`analysis.sweeps.ablation.JOBS`); seeds that an arm lacks are left out.
        seeds: of each arm in a small sweep, at least 2.
        requested_reference: the arm that others are compared with.
        twins: arms that are one search with it by construction, which nothing tests.

    Returns:
        A row for each metric, and each arm that has values of it: against itself, and against `requested_reference`,
        where this has values; none where there are too few seeds.
    """
    arms = sorted(dict.fromkeys(jobs.arm), key=lambda arm: arm != requested_reference)
    shared = sorted(set.intersection(*(set(jobs.seed[jobs.arm == arm]) for arm in arms)))
    blocks = [shared[start : start + seeds] for start in range(0, len(shared) - seeds + 1, seeds)]
    pairs = list(zip(blocks[::2], blocks[1::2], strict=False))
    searches = {arm: dict(zip(own.seed, own.search, strict=True)) for arm, own in jobs.groupby("arm")}
    rows = []
    for metric in Metric:
        samples, p = samples_of(jobs, metric), dict[tuple[str, str], list[float]]()
        tested = [arm for arm in arms if arm in samples and arm not in twins]
        for block in blocks if requested_reference in tested else []:
            for arm, corrected in _p(samples, searches, {arm: (arm, block) for arm in tested}).items():
                p.setdefault((arm, requested_reference), []).append(corrected)
        for arm, (one, other) in product(tested, pairs):
            own = _p(samples, searches, {"one": (arm, one), "other": (arm, other)})
            p.setdefault((arm, arm), []).append(own["other"])
        for (arm, against), values in p.items():
            rejected = sum(value < ALPHA for value in values)
            row = {"arm": arm, "against": against, "metric": metric.name, "sweeps": len(values), "rejected": rejected}
            rows.append(row | proportion(rejected, len(values)).columns("rate"))
    return pd.DataFrame(rows, columns=list(RATES)).astype(RATES)


def _p(
    samples: Mapping[str, Mapping[int, float]],
    searches: Mapping[str, Mapping[int, float]],
    picked: Mapping[str, tuple[str, Sequence[int]]],
) -> dict[str, float]:
    """Compare samples of these arms and seeds, by name, the first with each other, as if all had the first's seeds."""
    (_, shared), *_ = picked.values()

    def taken(values: Mapping[str, Mapping[int, float]]) -> dict[str, dict[int, float]]:
        return {
            name: {to: own[seed] for seed, to in zip(seeds, shared, strict=True) if seed in own}
            for name, (arm, seeds) in picked.items()
            for own in [values.get(arm, {})]
        }

    return corrected_p(taken(samples), taken(searches))
