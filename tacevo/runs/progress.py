"""What a user sees while a command works: lines, and on a terminal bars with rate and time left."""

from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.text import Text

from tacevo.evolution.archive import coverage
from tacevo.evolution.chance import is_at_chance
from tacevo.evolution.development import Outcome
from tacevo.evolution.lines import CandidateLine, GenerationLine, SearchLine
from tacevo.evolution.state import Plan, SearchState
from tacevo.records import Operator
from tacevo.rounding import significant
from tacevo.text import counted, printable


class Progress:
    """Lines and bars on standard error, or on another console; logs and pipes get the lines only."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            _RateColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def say(self, text: str) -> None:
        """Write one line, above the bars."""
        self._console.print(printable(text), highlight=False, markup=False, soft_wrap=True)

    def advance(self, what: str, done: int, total: int, note: str = "") -> None:
        """Move the bar of something, e.g. `images`, and write a note beside it."""
        if what not in self._tasks:
            self._tasks[what] = self._bars.add_task(what, total=total, note=note)
        self._bars.update(self._tasks[what], completed=done, note=note)


class _RateColumn(ProgressColumn):
    """Units a second, over the last half minute or so."""

    def render(self, task: Task) -> Text:
        """Write the rate, once there is one."""
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.2g}/s")


class Watcher:
    """Shows the candidates and generations of a search; the observer of a replay (`is_replay`)."""

    def __init__(self, plan: Plan, view: Progress, trivial: float | None = None, *, is_replay: bool = False) -> None:
        self._plan = plan
        self._view = view
        self._trivial = trivial
        self._is_replay = is_replay
        self._baseline: float | None = None
        self._done = 0
        self._total = 1 + plan.initial + plan.generations * plan.settings.candidates
        self._most = f"at most {self._total}" if plan.budget else str(self._total)

    def developed(self, outcome: Outcome) -> None:
        """Nothing is shown before it is committed."""

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Count a slot, or write the line of a generation."""
        if isinstance(line, CandidateLine) and line.operator is Operator.baseline:
            self._baseline = line.fitness
        covered = coverage(state.networks.archive, self._plan.networks.niches)
        beside = [("baseline", self._baseline), ("trivial", self._trivial)]
        others = ", ".join(f"{name} {significant(loss)}" for name, loss in beside if loss is not None)
        chance = ", at chance" if is_at_chance(state.best, self._trivial) else ""
        reached = f"best {significant(state.best)}{f' ({others})' if others else ''}{chance}, coverage {covered:.0%}"
        if not isinstance(line, GenerationLine):
            self._done += 1
            self._view.advance("slots", self._done, self._total, reached)
        else:
            again = "" if line.reevaluated is None else f", {counted(line.reevaluated, 'elite')} trained again"
            repaired = "" if line.repaired is None else f" and {line.repaired} after repair"
            trained = f": {line.trained} of {line.candidates} candidates trained{repaired}{again}"
            did = " replayed:" if self._is_replay else f"{trained},"
            self._view.say(f"generation {line.generation}{did} {reached} ({self._done} of {self._most} slots done)")
