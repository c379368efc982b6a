"""A table as a record; `analysis.tables.rendering` writes it as LaTeX, Markdown and CSV."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PValue:
    """A probability that is shown as `<0.001` where it is smaller than that."""

    value: float


@dataclass(frozen=True, slots=True)
class Halves:
    """A statistic that counts in halves, as U does; shown with one decimal."""

    value: float


@dataclass(frozen=True, slots=True)
class Percent:
    """A fraction in [0, 1] that is shown as a percentage."""

    value: float


@dataclass(frozen=True, slots=True)
class Between:
    """An estimate with the ends of its interval."""

    estimate: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class PercentBetween:
    """A fraction with the ends of its interval, shown as percentages."""

    estimate: float
    low: float
    high: float


#: None is a place that has no value.
Cell = str | int | float | PValue | Halves | Percent | Between | PercentBetween | None


def percent(share: float | None) -> Percent | None:
    """Show a fraction as a percentage, and None as an empty cell."""
    return None if share is None else Percent(share)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows under named columns."""

    #: Of its files, e.g. `study_force`.
    name: str
    caption: str
    #: Plain text, e.g. `test MSE`.
    columns: tuple[str, ...]
    #: Each as long as `columns`.
    rows: tuple[tuple[Cell, ...], ...]
    #: Sentences below it.
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the shape."""
        for number, row in enumerate(self.rows, start=1):
            if len(row) != len(self.columns):
                raise ValueError(f"row {number} of table {self.name} needs {len(self.columns)} cells; got {len(row)}")
