"""What is said of the common archive that all runs of a sweep are measured in."""

from collections.abc import Sequence

from analysis.rounding import shown
from analysis.sweeps.common_archive import Extent
from analysis.table import Percent


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
