"""A table as a record, laid out from a frame; `analysis.tables.rendering` writes it as LaTeX, Markdown and CSV."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import astuple, dataclass, is_dataclass
from typing import Any

import pandas as pd


@dataclass(frozen=True, slots=True)
class PValue:
    """A probability that is shown as `<0.001` where it is smaller than that."""

    value: float


@dataclass(frozen=True, slots=True)
class HalfInteger:
    """A statistic that counts in halves, as U does; shown with one decimal."""

    value: float


@dataclass(frozen=True, slots=True)
class Percent:
    """A fraction in [0, 1] that is shown as a percentage."""

    value: float


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate between the ends of its interval."""

    estimate: float
    low: float
    high: float

    def columns(self, name: str) -> dict[str, float]:
        """Return it as columns of a frame: NAME, NAME_low and NAME_high."""
        return {name: self.estimate, f"{name}_low": self.low, f"{name}_high": self.high}


@dataclass(frozen=True, slots=True)
class PercentInterval:
    """A fraction with the ends of its interval, shown as percentages."""

    estimate: float
    low: float
    high: float


#: The value of a cell; None where it is empty.
Cell = str | int | float | PValue | HalfInteger | Percent | Interval | PercentInterval | None


def percent(share: float | None) -> Percent | None:
    """Show a fraction as a percentage, and None as an empty cell."""
    return None if share is None else Percent(share)


def finite(value: float) -> float:
    """Return a number, once it is finite.

    Raises:
        ValueError: it is NaN or infinite.
    """
    if not math.isfinite(value):
        raise ValueError(f"a table's numbers must be finite; got {value}; use None for a missing value")
    return value


def interval_cell(estimate: float, low: float | None, high: float | None) -> Cell:
    """Return the cell of an estimate; without an interval, the value alone."""
    return estimate if low is None or high is None else Interval(estimate, low, high)


def percent_interval_cell(estimate: float, low: float | None, high: float | None) -> Cell:
    """Return the cell of a fraction; without an interval, the value alone."""
    return Percent(estimate) if low is None or high is None else PercentInterval(estimate, low, high)


#: The columns of a table by their heads. A column shows a column of the frame, by its name; or it makes each cell by a
#: function, which is given with the names of the frame's columns that it takes. Where the first of these values is
#: missing, the cell is empty; another missing value is given as None.
Layout = Mapping[str, str | tuple[Any, ...]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows under named columns."""

    #: The name of its files, e.g. `study_force`.
    name: str
    caption: str
    #: Plain text, e.g. `test MSE`.
    columns: tuple[str, ...]
    #: Each as long as `columns`.
    rows: tuple[tuple[Cell, ...], ...]
    #: Sentences below it.
    notes: tuple[str, ...] = ()
    #: The kind of question that it answers (`analysis.report.writing`): its name without a study's where none is given.
    kind: str = ""

    def __post_init__(self) -> None:
        """Check the shape."""
        object.__setattr__(self, "kind", self.kind or self.name.rpartition("/")[2])
        for number, row in enumerate(self.rows, start=1):
            if len(row) != len(self.columns):
                raise ValueError(f"row {number} of table {self.name} needs {len(self.columns)} cells; got {len(row)}")

    @classmethod
    def of(
        cls,
        frame: pd.DataFrame,
        layout: Layout,
        *,
        name: str,
        caption: str,
        notes: Iterable[str] = (),
        last: Iterable[tuple[Cell, ...]] = (),
        kind: str = "",
    ) -> "Table":
        """Lay out a frame, a row for each of its rows and then the `last` ones."""
        cells = (_cells(frame, *((None, how) if isinstance(how, str) else how)) for how in layout.values())
        rows = (*zip(*cells, strict=True), *last)
        return cls(name=name, caption=caption, columns=tuple(layout), rows=rows, notes=tuple(notes), kind=kind)

    @property
    def frame(self) -> pd.DataFrame:
        """The rows unrounded, as CSV has them: fractions as such, an interval as NAME, `NAME low` and `NAME high`.

        A column is Int64, Float64 or string, and `object` where it holds several kinds; a missing value is NA.

        Raises:
            ValueError: a cell is NaN or infinite.
        """
        columns = {}
        for column, name in enumerate(self.columns):
            cells = [_exact(row[column]) for row in self.rows]
            for at in range(max(map(len, cells), default=1)):
                values = [cell[at] if at < len(cell) else None for cell in cells]
                columns[f"{name}{('', ' low', ' high')[at]}"] = pd.Series(values, dtype=_dtype(values))
        return pd.DataFrame(columns)


def _exact(cell: Cell) -> list[str | int | float | None]:
    """Return a cell unrounded: one value, or an estimate and the ends of its interval."""
    if cell is None or isinstance(cell, str):
        return [cell]
    return [finite(value) for value in (astuple(cell) if is_dataclass(cell) else [cell])]


def _dtype(values: Iterable[str | int | float | None]) -> str:
    kinds = {type(value) for value in values} - {type(None)}
    return {int: "Int64", float: "Float64", str: "string"}.get(kinds.pop(), "object") if len(kinds) == 1 else "object"


def _cells(frame: pd.DataFrame, shape: Callable[..., Cell] | None, *names: str) -> list[Cell]:
    rows = zip(*([None if pd.isna(value) else value for value in frame[name].tolist()] for name in names), strict=True)
    return [None if row[0] is None else row[0] if shape is None else shape(*row) for row in rows]
