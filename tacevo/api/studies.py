"""A finished study, or noise run, of a run's networks."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from analysis.report.collection import Compared
from analysis.studies.comparison import of_whole
from analysis.studies.reestimates import Reestimates
from tacevo.api import frames
from tacevo.api.tables import Table
from tacevo.errors import RunError
from tacevo.results.run import RecordedRun
from tacevo.results.study import RecordedStudy as Scored
from tacevo.results.study import as_study
from tacevo.results.study_directory import FinishedStudy
from tacevo.results.study_lines import FailedLine, Row
from tacevo.rounding import rounded
from tacevo.text import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Study:
    """A finished study: networks of a run, trained again with several seeds and tested; or a noise run, or a choice."""

    def __init__(
        self,
        run: RecordedRun,
        finished: FinishedStudy,
        compared: Compared | None,
        reestimates: Reestimates | None,
        *,
        tables: Callable[[str], Mapping[str, Table]],
        figures: Callable[[str], Mapping[str, Callable[[], Figure]]],
        unread: str = "",
        left_out: str = "",
    ) -> None:
        self.recorded_run = run
        #: The reason why the study's re-estimates, which were made, cannot be read; empty where they can be, or there
        #: are none.
        self._unread = unread
        #: The reason why nothing of the study is compared, although it tests networks; empty where its comparison says
        #: that.
        self._left_out = left_out
        self._finished, self._compared, self._reestimates = finished, compared, reestimates
        self._tables, self._figures = tables, figures

    @property
    def name(self) -> str:
        """The name of the study's directory."""
        return self._finished.path.name

    @property
    def recorded(self) -> Scored:
        """The content of the study's files; raises RunError of a noise run or a choice, which have no test scores."""
        return as_study(self._finished)

    @property
    def digest(self) -> str:
        """The last hash of its scores, which stands for all of them."""
        return self._finished.digest

    @property
    def is_noise(self) -> bool:
        """Whether it trains as the search did and tests nothing (`tacevo noise`)."""
        return self._finished.record.is_noise

    @property
    def is_choice(self) -> bool:
        """Whether its trainings, one of each elite, chose the network of another study (`choose=validated`)."""
        return self._finished.record.is_choice

    @property
    def networks(self) -> pd.DataFrame:
        """The networks, the baseline first; columns: `tacevo.api.frames.NETWORKS`."""
        rows = ({**asdict(one), "network": one.name} for one in self._finished.header.networks)
        return frames.frame(rows, frames.NETWORKS, index="network")

    @property
    def scores(self) -> pd.DataFrame:
        """A row a network and seed, a column a test metric; columns: docs/python.md.

        A metric is of the test images, by the weights of the epoch with the lowest validation loss; in training units,
        an accuracy in [0, 1]. A training that failed has its reason in `failed`, and no other value.
        """
        rows = self._finished.rows
        metrics = dict.fromkeys((name for row in rows for name in getattr(row, "metrics", ())), "float64")
        return frames.frame(map(_score, rows), {**frames.SCORES, **metrics})

    @property
    def verdicts(self) -> pd.DataFrame:
        """A row a variant: its comparison with the baseline; columns: docs/python.md.

        Mann-Whitney's U and p, p after Holm over all variants, A12 and the difference of medians with intervals, the
        test of equivalence, a verdict in a word. Where nothing could be compared (a noise run, a baseline alone, too
        few seeds), it has no rows, and shows the reason; `frame.attrs["left_out"]` has it, too.
        """
        one = self._compared
        rows = [] if one is None or one.comparisons is None else _verdicts(one.study, one.comparisons)
        known = frames.frame(rows, frames.VERDICTS, index="network")
        return known if rows else _Explained.of(known, self._uncompared)

    @property
    def _uncompared(self) -> str:
        """The error that says why the study has no verdicts."""
        if self.is_noise:
            return "a noise run tests nothing; `reestimates` has what it found"
        if self.is_choice:
            return "a choice tests nothing; `scores` has its validation losses"
        return self._left_out if self._compared is None else self._compared.uncompared

    @property
    def reestimates(self) -> pd.DataFrame:
        """A row a network and seed: the recorded fitness, and that under this seed; columns: docs/python.md.

        Without rows where the losses are no fitnesses: other data, another recipe, fewer epochs.

        Raises:
            RunError: the stores do not have its trainings.
        """
        check_read([self._unread] if self._unread else [])
        return frames.frame([] if self._reestimates is None else _estimated(self._reestimates), frames.REESTIMATES)

    @property
    def tables(self) -> Mapping[str, Table]:
        """The study's tables by name, as `verdicts`."""
        return self._tables(self.name)

    @property
    def figures(self) -> Mapping[str, Callable[[], Figure]]:
        """The study's figures by name, as `seed_boxes`; each is a function that draws one."""
        return self._figures(self.name)

    def __repr__(self) -> str:
        header = self._finished.header
        seeds = counted(header.seeds, "seed")
        facts = f"{header.what} {self.name}: {len(header.networks)} networks, {seeds}"
        return "; ".join([f"<{facts}", *([self._unread] if self._unread else [])]) + ">"

    def _repr_html_(self) -> str:
        shown = self.reestimates if self.is_noise else self.verdicts
        why = "" if self.is_noise or not shown.empty else f"<p>{html.escape(shown.attrs['left_out'][0])}</p>"
        return f"<p>{html.escape(repr(self)[1:-1])}</p>{why or shown.to_html(na_rep='')}"


class _Explained(pd.DataFrame):  # type: ignore[misc]  # pandas comes without types
    """A frame without rows that shows why."""

    @classmethod
    def of(cls, frame: pd.DataFrame, reason: str) -> _Explained:
        explained = cls(frame)
        explained.attrs["left_out"] = (f"no verdicts: {reason}",)
        return explained

    @property
    def _constructor(self) -> Any:
        return pd.DataFrame  # what is made of it is a frame as any other

    def __repr__(self) -> str:
        return "\n".join(self.attrs["left_out"])

    def _repr_html_(self) -> str:
        return "".join(f"<p>{html.escape(reason)}</p>" for reason in self.attrs["left_out"])


def check_read(unread: Iterable[str]) -> None:
    """Raise where re-estimates that were made cannot be read: without them a fitness would be another number.

    Raises:
        RunError: there are reasons why some cannot.
    """
    for reason in unread:
        raise RunError(reason)


class Studies(tuple[Study, ...]):
    """The studies of a run, as a tuple, which says in words what is not among them, and why."""

    #: The reasons why other studies are not shown, a sentence each.
    left_out: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Write it as any tuple, and behind it what was left out."""
        return "; ".join([super().__repr__(), *(f"left out: {reason}" for reason in self.left_out)])


def _score(row: Row) -> dict[str, Any]:
    if isinstance(row, FailedLine):
        return {"network": row.network, "id": row.id, "seed": row.seed, "failed": row.reason.value}
    return {**asdict(row), **row.metrics}


def _verdicts(study: Scored, comparisons: pd.DataFrame) -> list[dict[str, Any]]:
    ids = {network.name: network.id for network in study.networks}
    baseline = rounded(float(np.median(study.values(study.networks[0].name, study.primary))))
    shared = {"metric": study.primary, "baseline_median": baseline}
    return [row | shared | {"id": ids[row["network"]]} for row in of_whole(comparisons).to_dict("records")]


def _estimated(again: Reestimates) -> Iterator[dict[str, Any]]:
    for network, estimates in zip(again.networks, again.estimates, strict=True):
        for seed, fitness in enumerate(estimates):
            yield {
                "network": network.name,
                "id": network.id,
                "recorded": network.fitness,
                "seed": seed,
                "fitness": fitness,
            }
