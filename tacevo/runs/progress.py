"""What a person sees while a run is at work: bars on a terminal, plain lines elsewhere."""

import math
from types import TracebackType
from typing import Protocol, Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from tacevo.search.algorithm import Plan, SearchState
from tacevo.search.archive import coverage
from tacevo.search.development import Outcome
from tacevo.search.lines import CandidateLine, SearchLine
from tacevo.text import printable


class Listener(Protocol):
    """Who is told how far the data are, and whatever fits in a line."""

    def say(self, text: str) -> None:
        """Show one line."""

    def data(self, done: int, total: int) -> None:
        """Show how many images of a data set are made."""


class StudyView(Listener, Protocol):
    """Who is told how far a study is."""

    def trained(self, done: int, total: int) -> None:
        """Show how many trainings are done."""


class SweepView(Listener, Protocol):
    """Who is told how far a sweep is."""

    def jobs(self, done: int, total: int) -> None:
        """Show how many jobs are finished."""


class View(Listener, Protocol):
    """Who is told how far a run is."""

    def committed(self, line: SearchLine, coverage: float, best: float) -> None:
        """Show a line of the ledger, and how far the archive is with it."""


class PlainView:
    """One line a generation, for logs and pipes.

    Args:
        console: where to write.
        total: candidates of the whole run; None where it is not known.
    """

    def __init__(self, console: Console, total: int | None = None) -> None:
        self._console = console
        self._of_total = "" if total is None else f" of {total}"
        self._done = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing is left open."""

    def say(self, text: str) -> None:
        """Write one line."""
        self._console.print(printable(text), highlight=False, markup=False, soft_wrap=True)

    def data(self, done: int, total: int) -> None:
        """Write when the images are complete."""
        if done == total:
            self.say(f"data: {total} images made")

    def committed(self, line: SearchLine, coverage: float, best: float) -> None:
        """Write a line at the end of each generation."""
        if isinstance(line, CandidateLine):
            self._done += 1
        else:
            repaired = "" if line.repaired is None else f" and {line.repaired} after repair"
            self.say(
                f"generation {line.generation}: {line.trained} of {line.candidates} candidates trained"
                f"{repaired}, best "
                f"{best:.4g}, coverage {coverage:.0%} ({self._done}{self._of_total} candidates done)"
            )

    def trained(self, done: int, total: int) -> None:
        """Write a line at each tenth of a study."""
        if 10 * done // total > 10 * (done - 1) // total:
            self.say(f"{done} of {total} trainings are done")

    def jobs(self, done: int, total: int) -> None:
        """Nothing is shown but the line of each job."""

    def tracked(self, done: int, total: int) -> None:
        """Write nothing: what came of the runs is told at the end."""


class _LiveBars:
    """Bars with rate and time left, on a terminal: what all of them show.

    Args:
        console: the terminal.
    """

    def __init__(self, console: Console) -> None:
        self._progress = _bars(console)
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """Write one line above the bars."""
        self._progress.console.print(printable(text), highlight=False, markup=False, soft_wrap=True)

    def data(self, done: int, total: int) -> None:
        """Move the bar of the images."""
        self._move("images", done, total)

    def _move(self, name: str, done: int, total: int) -> None:
        if name not in self._tasks:
            self._tasks[name] = self._progress.add_task(name, total=total, note="")
        self._progress.update(self._tasks[name], completed=done)


class LiveTrackView(_LiveBars):
    """The bar of runs on their way into MLflow."""

    def tracked(self, done: int, total: int) -> None:
        """Move the bar."""
        self._move("runs", done, total)


class LiveStudyView(_LiveBars):
    """The bars of a study."""

    def trained(self, done: int, total: int) -> None:
        """Move the bar of the trainings."""
        self._move("trainings", done, total)


class LiveView(_LiveBars):
    """The bars of a search.

    Args:
        console: the terminal.
        total: candidates of the whole run.
        generations: G.
    """

    def __init__(self, console: Console, total: int, generations: int) -> None:
        super().__init__(console)
        self._generations = generations
        self._search = self._progress.add_task(f"generation 0/{generations}", total=total, note="")

    def committed(self, line: SearchLine, coverage: float, best: float) -> None:
        """Move the bar of the candidates."""
        if isinstance(line, CandidateLine):
            self._progress.update(
                self._search,
                advance=1,
                description=f"generation {line.generation}/{self._generations}",
                note=f"best {best:.4g}  coverage {coverage:.0%}",
            )


class _RateColumn(ProgressColumn):
    """Units a second, over the last half minute or so."""

    def render(self, task: Task) -> Text:
        """Write the rate, once there is one."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.2g}/s")


class LiveSweepView(_LiveBars):
    """The bar of a sweep's jobs."""

    def jobs(self, done: int, total: int) -> None:
        """Move the bar of the jobs."""
        self._move("jobs", done, total)


def _bars(console: Console) -> Progress:
    """Lay out bars with a note, rate and time left."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        _RateColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


def make_study_view(console: Console) -> PlainView | LiveStudyView:
    """Choose the view of a study that suits a console."""
    return LiveStudyView(console) if console.is_terminal else PlainView(console)


def make_sweep_view(console: Console) -> PlainView | LiveSweepView:
    """Choose the view of a sweep that suits a console."""
    return LiveSweepView(console) if console.is_terminal else PlainView(console)


def make_track_view(console: Console) -> PlainView | LiveTrackView:
    """Choose the view of runs on their way into MLflow that suits a console."""
    return LiveTrackView(console) if console.is_terminal else PlainView(console)


def make_view(console: Console, *, total: int, generations: int) -> PlainView | LiveView:
    """Choose the view that suits a console."""
    return LiveView(console, total, generations) if console.is_terminal else PlainView(console, total)


class Watcher:
    """Shows a search to a view; the observer of a replay."""

    def __init__(self, plan: Plan, view: View) -> None:
        self._plan = plan
        self._view = view

    def developed(self, outcome: Outcome) -> None:
        """Nothing is shown before it is committed."""

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Show a line."""
        archive = state.networks.archive
        best = min((-elite.objective for elite in archive.elites.values()), default=math.nan)
        self._view.committed(line, coverage(archive, self._plan.networks.niches), best)
