"""The archives of a sweep's arms: the common one that all runs are measured in, and theirs after re-estimates."""

from collections.abc import Mapping, Sequence

from analysis.rounding import shown
from analysis.statistics.effects import median
from analysis.studies.corrected import Corrected
from analysis.sweeps.common_archive import Extent
from analysis.table import Between, Cell, Percent, PercentBetween, Table
from tacevo.results.sweep import RecordedSweep


def common_note(niches_of: str) -> str:
    """Name the archive that coverage and QD-score were counted in."""
    return (
        "QD-score and coverage are those of one common archive: every trained candidate of a run, in order, in the "
        f"niches of {niches_of} under bounds common to all runs. They are not those of a run's own ledger."
    )


def extents_note(extents: Sequence[Extent]) -> str:
    """Name the candidates that decide the bounds of the common archive, and how close these leave all others."""
    axes = (
        f"{one.axis} from {_end(one.low, one.lowest)} to {_end(one.high, one.highest)}, with "
        f"{shown(Percent(one.fullest))} of all candidates in the fullest tenth"
        for one in extents
    )
    return (
        f"Its bounds: {'; '.join(axes)}. A single candidate may decide a bound, and with it how many niches all fill."
    )


def _end(value: float, candidates: Sequence[str]) -> str:
    """Write a bound with the candidates that it is due to, or that it was fixed."""
    if not candidates:
        return f"{shown(value)} (fixed)"
    more = f" and {len(candidates) - 1} more" if len(candidates) > 1 else ""
    return f"{shown(value)} ({candidates[0]}{more})"


def corrected_arms_table(sweep: RecordedSweep, arms: Sequence[str], corrected: Mapping[str, Corrected]) -> Table:
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
