"""The progress that a user sees while a command works: lines, and on a terminal bars with rate and time left."""

import threading
import time
from collections.abc import Callable
from datetime import timedelta
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TaskID
from rich.progress import Progress as Bars
from rich.table import Column
from rich.text import Text

from tacevo.evolution.archive import coverage
from tacevo.evolution.chance import is_at_chance
from tacevo.evolution.development import Outcome
from tacevo.evolution.lines import CandidateLine, GenerationLine, SearchLine
from tacevo.evolution.state import Plan, SearchState
from tacevo.records import Operator, Training
from tacevo.rounding import significant
from tacevo.text import lasting, unbroken

#: Seconds from which on a search says how long it takes.
LONG = 600.0

#: What is said of a run or a study that the same command finished before.
FINISHED_BEFORE = "finished before; nothing to do"

#: Seconds without a line after which a log gets one: so many at first, then a part of the time that the work took, but
#: not more than the last; so a log of a day has a line a minute.
SILENCE, _PART, _LONGEST = 5.0, 1 / 40, 60.0


def told_saving(part: float, seconds: float) -> list[str]:
    """Say in one line what AVX-512 saves, such a part of so many seconds; nothing where it is less than a minute."""
    if part * seconds < 60:
        return []
    return [
        f"numerics=portable512 would save {lasting(part * seconds)} of it ({part:.0%}), measured now on the baseline; "
        "its bits are others, and equal on CPUs with AVX-512 only"
    ]


class Progress:
    """Lines and bars on standard error, or on another console.

    On a terminal a clock runs while no bar does. Logs and pipes get the lines, and one that says how far the work is
    whenever nothing was said for `silence` seconds, or some more where the work is long. So a command that works is
    never still.
    """

    def __init__(self, console: Console | None = None, silence: float = SILENCE) -> None:
        self._console = console or Console(stderr=True)
        self._bars = Bars(
            _Words(lambda task: task.description),
            BarColumn(bar_width=12),
            _Words(_count, Column(no_wrap=True)),
            _Words(lambda task: task.fields["note"]),
            _Words(_pace, Column(no_wrap=True)),
            _Words(_time, Column(no_wrap=True)),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        #: Each bar knows how many units were not made while it ran, `before`, and the seconds until the first, `idle`.
        self._tasks: dict[str, TaskID] = {}
        self._clock = self._bars.add_task("at work", total=None, note="", before=0, idle=0.0)
        self._ended = threading.Event()
        self._silence = silence
        self._began = self._last = time.monotonic()

    def __enter__(self) -> Self:
        self._bars.start()
        if self._bars.disable and not self._console.quiet:
            threading.Thread(target=self._remind, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._bars.stop()

    def say(self, text: str) -> None:
        """Write one line, above the bars."""
        self._last = time.monotonic()
        self._console.print(unbroken(text), highlight=False, markup=False, soft_wrap=True)

    def advance(self, what: str, done: int, total: int, note: str = "", *, recalled: bool = False) -> None:
        """Move the bar of something, e.g. `images`, and write a note beside it; with fewer done, it begins again.

        What is `recalled`, from a store or an earlier run of the command, says nothing of how long the rest takes: it
        enters no rate, nor does the time before the first that was made.
        """
        if what not in self._tasks:
            self._tasks[what] = self._bars.add_task(what, total=total, completed=done, note=note, before=done, idle=0.0)
        task = self._bars.tasks[self._tasks[what]]
        if done < task.completed:
            self._bars.reset(task.id, completed=done, note=note, before=done, idle=0.0)
        elif recalled:
            if task.completed == task.fields["before"]:  # nothing was made yet
                task.fields["idle"] = task.elapsed or 0.0
            task.fields["before"] += done - task.completed
        self._bars.update(task.id, completed=done, total=total, note=note)
        is_still = all(task.finished for task in self._bars.tasks if task.id != self._clock)
        if is_still != self._bars.tasks[self._clock].visible:
            self._bars.reset(self._clock, visible=is_still)

    def _remind(self) -> None:
        """Write how far the work is after each silence, until it ends."""
        while not self._ended.wait(max(0.0, self._due - time.monotonic())):
            if time.monotonic() >= self._due:
                self.say(self._standing())

    @property
    def _due(self) -> float:
        """The time when the next line is due."""
        return self._last + max(self._silence, min(_LONGEST, _PART * (self._last - self._began)))

    def _standing(self) -> str:
        """Say how far the unfinished work is, and how long the rest takes; of what is not counted, how long it took."""
        *_, shown = [task for task in self._bars.tasks if not task.finished]  # the clock is first, and has no end
        if shown.id == self._clock:
            return f"at work for {lasting(shown.elapsed or 0)}"
        left = _left(shown)
        ahead = f"at work for {lasting(shown.elapsed or 0)}" if left is None else f"{lasting(left)} left"
        note = f", {shown.fields['note']}" if shown.fields["note"] else ""
        return f"{shown.description}: {shown.completed:.0f} of {shown.total:.0f}{note}, {ahead}"


def _rate(task: Task) -> float | None:
    """Return the units that are made a second; None before there is one."""
    seconds = (task.finished_time or task.elapsed or 0.0) - task.fields["idle"]
    return (task.completed - task.fields["before"]) / seconds if seconds > 0 else None


def _left(task: Task) -> float | None:
    """Return the seconds that the rest takes at the rate so far; None where this is not known."""
    rate = _rate(task)
    return (task.total - task.completed) / rate if rate and task.total is not None else None


def _count(task: Task) -> str:
    """Write how much is done, where it is counted."""
    return "" if task.total is None else f"{task.completed:.0f}/{task.total:.0f}"


def _pace(task: Task) -> str:
    """Write the units a second, or a minute where they are slow, once there are any."""
    rate = _rate(task) if task.total is not None else None
    if not rate:
        return ""
    return f"{rate:.2g}/s" if rate >= 1 else f"{60 * rate:.2g}/min"


def _time(task: Task) -> str:
    """Write the time that the rest takes, or where this is not known, or nothing is left, the time that it took."""
    left = None if task.finished else _left(task)
    seconds = (task.finished_time or task.elapsed or 0) if left is None else left
    return f"{timedelta(seconds=round(seconds))}{'' if left is None else ' left'}"


class _Words(ProgressColumn):
    """A text; without a column of its own it is cut where the terminal is narrow, and what the others say is not."""

    def __init__(self, write: Callable[[Task], str], column: Column | None = None) -> None:
        super().__init__(column)
        self._write = write

    def render(self, task: Task) -> Text:
        """Write the text on one line."""
        return Text(self._write(task), no_wrap=True, overflow="ellipsis")


class Watcher:
    """Shows the candidates and generations of a search; the observer of a replay (`is_replay`).

    `did` is what becomes of candidates: `trained`, or `looked up` in a table (`tacevo.results.summary.evaluated`).
    How long a search takes is told by the pace of the trainings so far, `at_once` of which run together; and where that
    is long, what part of it `saving` measures (`tacevo.runs.pace.part_saved`). Trainings that are recalled enter no
    pace; only where none is ever made, in a replay or with a table, candidates that are done do.
    """

    def __init__(
        self,
        plan: Plan,
        view: Progress,
        trivial: float | None = None,
        *,
        is_replay: bool = False,
        did: str = "trained",
        at_once: int = 1,
        saving: Callable[[], float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._plan = plan
        self._view = view
        self._trivial = trivial
        self._is_replay = is_replay
        self._did = did
        self._at_once = at_once
        self._saving = saving
        self._clock = clock
        #: The time when the first training began that was not recalled, and the candidates done since that were not.
        self._began: float | None = None
        self._made = 0
        #: Whether trainings are made at all; and the candidates that took the time of one, until they are committed.
        self._trains = not is_replay and did == "trained"
        self._fresh: set[str] = set()
        self._baseline: float | None = None
        self._done = 0
        self._total = 1 + plan.initial + plan.generations * plan.settings.candidates
        self._most = f"at most {self._total}" if plan.budget else str(self._total)
        view.advance("candidates", 0, self._total)

    def developed(self, outcome: Outcome) -> None:
        """Say at the first training how long the search takes, if that is long; all else is shown once committed."""
        # A rejection takes no training, and is part of the work once there is some; before that it was recalled, too.
        is_made = outcome.cpu_seconds > 0 or (self._began is not None and not isinstance(outcome.result, Training))
        if is_made:
            self._fresh.add(outcome.proposal.id)
        if self._began is not None or outcome.cpu_seconds == 0:
            return
        self._began = self._clock() - outcome.seconds
        left = outcome.seconds * (self._total - self._done) / self._at_once
        if left >= LONG:
            most = "at most " if self._plan.budget else ""
            self._view.say(
                f"{most}{lasting(left)} at the pace of the first training, beside waiting for answers; Ctrl-C stops "
                "the search, and the same command continues it"
            )
            for line in told_saving(0.0 if self._saving is None else self._saving(), left):
                self._view.say(line)

    def _left(self) -> str:
        """Write how long the rest takes at the pace so far, if that is long."""
        if self._began is None:
            return ""
        left = (self._clock() - self._began) / max(self._made, 1) * (self._total - self._done)
        return f", {lasting(left)} left" if left >= LONG else ""

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
            is_made = not self._trains or line.id in self._fresh
            self._fresh.discard(line.id)
            self._done += 1
            self._made += is_made
            self._view.advance("candidates", self._done, self._total, reached, recalled=not is_made)
        else:
            self.tell(line, reached)

    def tell(self, line: GenerationLine, reached: str) -> None:
        """Write the line of a generation; `reached` is what the search has come to."""
        repaired = "" if line.repaired is None else f" and {line.repaired} after repair"
        skipped = "" if line.skipped is None else f", {line.skipped} skipped"
        trained = f": {line.trained} of {line.candidates} candidates {self._did}{repaired}{skipped}"
        did = " replayed:" if self._is_replay else f"{trained},"
        self.say(f"generation {line.generation}{did} {reached}")

    def say(self, text: str) -> None:
        """Write a line, with how far the search is."""
        self._view.say(f"{text} ({self._done} of {self._most} candidates done{self._left()})")
