"""Tables and figures by short names, the same that `tacevo tables` and `tacevo figures` write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from analysis.table import Table as Rows
from analysis.tables.rendering import as_latex, as_markdown
from tacevo.errors import ConfigError
from tacevo.text import listed, nearest

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")


@dataclass(frozen=True, slots=True, repr=False)
class Table:
    """A table: rows under named columns, with a caption and notes."""

    _rows: Rows

    @property
    def caption(self) -> str:
        """The sentence that says what the table shows."""
        return self._rows.caption

    @property
    def notes(self) -> tuple[str, ...]:
        """The sentences that say how the table is read."""
        return self._rows.notes

    @property
    def frame(self) -> pd.DataFrame:
        """The content of the CSV file, unrounded: fractions as such, an interval as three columns; empty is missing."""
        return self._rows.frame

    def to_latex(self) -> str:
        """Write it for LaTeX, which needs the packages `booktabs` and `array`."""
        return as_latex(self._rows)

    def to_markdown(self) -> str:
        """Write it as GitHub's Markdown."""
        return as_markdown(self._rows)

    def __str__(self) -> str:
        return self.to_markdown()

    def __repr__(self) -> str:
        return f"<table: {self.caption}>"

    def _repr_html_(self) -> str:
        return f"<p>{self.caption}</p>{self.frame.to_html(index=False, na_rep='')}"


class Named(Mapping[str, T]):
    """Values by name; an unknown name is answered with the nearest.

    Args:
        values: by name.
        what: they are called, such as `run.tables`.
        lacking: why others are not there, a sentence each.

    Raises:
        ConfigError: on a lookup, there is none of this name.
    """

    def __init__(self, values: Mapping[str, T], what: str, lacking: Sequence[str] = ()) -> None:
        self._values, self._what, self.lacking = values, what, tuple(lacking)

    def __getitem__(self, name: str) -> T:
        if name not in self._values:
            raise ConfigError(
                repr(name),
                place=self._what,
                expected=f"one of {listed(self._plain)}",
                remedy="; ".join(
                    [
                        nearest(
                            name, list(self._values), f"list({self._what}) has all, those of each study among them"
                        ),
                        *self.lacking,
                    ]
                ),
            )
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __repr__(self) -> str:
        return "; ".join([f"<{self._what}: {listed(self._plain)}", *self.lacking]) + ">"

    @property
    def _plain(self) -> list[str]:
        return [name for name in self._values if "/" not in name]
