"""Tables and figures by short names, the same that `tacevo tables` and `tacevo figures` write."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from analysis.table import Table as Rows
from analysis.tables.rendering import as_latex, as_markdown
from tacevo.errors import ConfigError
from tacevo.text import listed, nearest

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Table:
    """A table: rows under named columns, with a caption and notes."""

    _rows: Rows

    @property
    def caption(self) -> str:
        """What it shows, in a sentence."""
        return self._rows.caption

    @property
    def notes(self) -> tuple[str, ...]:
        """How it is read, a sentence each."""
        return self._rows.notes

    @property
    def frame(self) -> pd.DataFrame:
        """What its CSV file holds, unrounded: fractions as such, an interval as three columns; empty is missing."""
        return self._rows.frame

    def to_latex(self) -> str:
        """Write it for LaTeX, which needs the packages `booktabs` and `array`."""
        return as_latex(self._rows)

    def to_markdown(self) -> str:
        """Write it as GitHub's Markdown."""
        return as_markdown(self._rows)

    def _repr_html_(self) -> str:
        return f"<p>{self.caption}</p>{self.frame.to_html(index=False, na_rep='')}"


class Named(Mapping[str, T]):
    """Values by name; an unknown name is answered with the nearest.

    Raises:
        ConfigError: on a lookup, there is none of this name.
    """

    def __init__(self, values: Mapping[str, T], what: str) -> None:
        self._values, self._what = values, what

    def __getitem__(self, name: str) -> T:
        if name not in self._values:
            raise ConfigError(
                repr(name),
                place=self._what,
                expected=f"one of {listed(self._plain)}",
                remedy=nearest(name, list(self._values), f"list({self._what}) has all, those of each study among them"),
            )
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __repr__(self) -> str:
        return f"<{self._what}: {listed(self._plain)}>"

    @property
    def _plain(self) -> list[str]:
        return [name for name in self._values if "/" not in name]


def short_names(values: Mapping[str, T], task: str, studies: Iterator[str] | tuple[str, ...]) -> dict[str, T]:
    """Name what belongs to a run and its studies: `gate`, `verdicts`, `STUDY/verdicts`.

    A plain name is that of the run or of the first study that has one; every study's own begins with the study.

    Args:
        values: by the names of files, as `gate_force` and `verdicts_force_STUDY`.
        task: the name of the task.
        studies: in the order in which they are taken for a plain name.
    """
    own: dict[str, T] = {}
    of_studies: dict[str, dict[str, T]] = {study: {} for study in studies}
    for name, value in values.items():
        study = next((study for study in of_studies if name.endswith(f"_{study}")), None)
        if study is None:
            own[name.removesuffix(f"_{task}")] = value
        else:
            of_studies[study][name.removesuffix(f"_{study}").removesuffix(f"_{task}")] = value
    for study, named in of_studies.items():
        for name, value in named.items():
            own.setdefault(name, value)
            own[f"{study}/{name}"] = value
    return own
