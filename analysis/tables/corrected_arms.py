"""The table of a sweep's archives as recorded, and after their elites were trained again."""

from collections.abc import Mapping, Sequence

from analysis.statistics.effects import median
from analysis.studies.corrected import Corrected
from analysis.sweeps.sweep import Sweep
from analysis.table import Between, Cell, Percent, PercentBetween, Table


def corrected_arms_table(sweep: Sweep, arms: Sequence[str], corrected: Mapping[str, Corrected]) -> Table:
    """Show the figures of each arm's archives as recorded beside the corrected ones.

    Args:
        sweep: of the jobs.
        arms: their names, in the order of the other tables.
        corrected: by the names of all finished jobs.
    """
    return Table(
        name=f"ablation_corrected_{sweep.task}",
        caption=f"The archives of the arms ({sweep.task}) as recorded, and after their elites were trained again.",
        columns=(
            *("arm", "seeds", "best fitness", "best fitness, corrected", "QD-score", "QD-score, corrected"),
            *("coverage", "coverage, corrected"),
        ),
        rows=tuple(
            _row(arm, [corrected[one.job.name] for one in sweep.finished if one.job.arm == arm]) for arm in arms
        ),
        notes=(
            "The elites of each run, in the niches of the common archive: by their recorded fitness, and by the median "
            "under other training seeds. Other tables count every trained candidate there, so their QD-score and "
            "coverage are higher.",
            "Median over the seeds, with the interval of the sign test. A recorded archive holds the luckiest of its "
            "candidates (Flageat and Cully 2023); what is compared and tested is the test score of what a job found.",
        ),
    )


def _row(arm: str, jobs: Sequence[Corrected]) -> tuple[Cell, ...]:
    sides = [one.recorded for one in jobs], [one.reestimated for one in jobs]
    return (
        arm,
        len(jobs),
        *(_median([one.best for one in side]) for side in sides),
        *(_median([one.qd_score for one in side]) for side in sides),
        *(_median([one.coverage for one in side], is_share=True) for side in sides),
    )


def _median(values: Sequence[float | None], *, is_share: bool = False) -> Cell:
    known = [value for value in values if value is not None]
    if len(known) < 2:
        return Percent(known[0]) if known and is_share else next(iter(known), None)
    found = median(known)
    return (PercentBetween if is_share else Between)(found.estimate, found.low, found.high)
