"""The report page of a run or a sweep that may still be at work: written again while it grows.

What it promises: the page is written atomically, and only where it changed; it shows whole generations whose hashes
agree. Its script reloads it and keeps its place; the page that stands in the end does not reload.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from analysis.report.collection import Collection, collect, tables_of
from analysis.report.page.html import as_html
from analysis.report.page.of_run import RunMaterial, read_texts
from analysis.report.page.of_sweep import sweep_contents
from analysis.report.page.whole import PageContents, page_contents
from analysis.report.sweep_collection import collect_sweep
from analysis.runs.archive_history import load_begun
from tacevo.errors import RunError, TacevoError
from tacevo.evolution.run_files import finished_digest
from tacevo.storage.files import write_durably
from tacevo.storage.notes import NOTE, read_note
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.text import counted, plain

#: Seconds between two looks at the files.
EVERY = 3.0

#: Looks at which no run was at work, after which a sweep is not followed further: its next job takes a while to begin.
#: A run is left at the second.
PATIENCE = 20

#: The files of a run that its page follows from.
_FOLLOWED = (NOTE, "run.json", "ledger.jsonl", "studies/*/study.json")

_CHECKED = (
    "Each ledger's chain, as far as it goes. A run that is not finished has no digest of its own yet.",
    "`tacevo report` of a finished run also draws sample images, compares motifs and has sections of installed parts; "
    "this page does not.",
)


def follow(path: Path, page: Path, store: Path | None = None, say: Callable[[str], object] = lambda line: None) -> None:
    """Write the page of a run or a sweep whenever it has changed, until all its searches are finished.

    However this ends, the last page that it writes does not reload itself.

    Args:
        path: the directory of a run or a sweep that has begun.
        page: the file to write.
        store: where the stores lie, if not where the runs have them.
        say: is called with a line whenever the page was written.

    Raises:
        RunError: nothing has begun there, or no process is at work on what is not finished.
    """
    if not any((path / name).exists() for name in ("run.json", "sweep.json")):
        got, expected = "a path without run.json and sweep.json", "the directory of a run or a sweep that has begun"
        raise RunError(got, place=str(path), expected=expected)
    followed, written, idle = Followed(path, store), None, 0
    try:
        while not followed.is_finished:
            shown = followed.now()
            if shown != written:
                write_durably(page, as_html(shown))
                written = shown
                generations = sum(len(run["generations"]) for run in shown.runs)
                say(f"written with {counted(generations, 'generation')}: {shown.state}")
            if not followed.is_finished:
                idle = 0 if followed.is_at_work else idle + 1
                if idle > (PATIENCE if SweepDirectory(path).is_one else 1):
                    raise _stopped(path, shown)
                time.sleep(EVERY)
    finally:
        if written is not None:
            write_durably(page, as_html(replace(written, live=False)))


def _stopped(path: Path, shown: PageContents) -> RunError:
    return RunError(
        f"none. {shown.state}",
        place=str(path),
        expected="a process at work, since not all is finished",
        remedy="the command that began it goes on with it; the page shows it as far as it came",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reading:
    """What a run gave when it was last read."""

    #: What tells whether it has changed.
    seen: object
    is_finished: bool
    is_busy: bool
    #: What its page is made from; None before its first generation has ended.
    material: RunMaterial | None


class Followed:
    """The run or sweep of a directory as it is now; a run is read again when a file of it has changed.

    `store` is where the stores lie, if not where the runs have them.
    """

    def __init__(self, path: Path, store: Path | None = None) -> None:
        self._path = path
        self._store = store
        self._readings: dict[Path, _Reading] = {}
        self._shown = page_contents([], title=path.resolve().name, live=True, checked=_CHECKED)
        #: Whether all its searches were finished when it was last read, and whether a process was at work on one.
        self.is_finished = self.is_at_work = False

    def now(self) -> PageContents:
        """Return its page; where files cannot be read, the last one and why."""
        try:
            directory = SweepDirectory(self._path)
            runs = [RunDirectory(self._path)]
            if directory.is_one:
                runs = [directory.run(job) for job in directory.read().jobs]
            self.is_at_work = any(run.is_busy for run in runs)
            readings = [self._read(run) for run in runs]
            sweep, reason = self._compared() if directory.is_one else (None, "")
            finished, busy = sum(one.is_finished for one in readings), sum(one.is_busy for one in readings)
            self._shown = page_contents(
                [one.material for one in readings if one.material is not None],
                sweep=sweep,
                title=self._path.resolve().name,
                live=True,
                state=f"{finished} of {counted(len(readings), 'run')} finished, {busy} at work.{reason}",
                checked=_CHECKED,
            )
            self.is_finished = finished == len(readings)
        except (TacevoError, OSError) as error:  # e.g. a file that was removed, because the search begins again
            self._shown = replace(self._shown, state=f"This cannot be read now: {error}")
        return self._shown

    def _read(self, run: RunDirectory) -> _Reading:
        """Read a run, if it has changed since the last time."""
        files = [file for pattern in _FOLLOWED for file in sorted(run.path.glob(pattern))]
        is_busy = run.is_busy
        seen = is_busy, *map(_state_of, files)
        known = self._readings.get(run.path)
        if known is None or known.seen != seen:
            is_finished = (run.path / "run.json").exists() and finished_digest(run) is not None
            shown, material = self._collected(run, is_finished=is_finished), None
            if shown is not None:
                remarks = [*map(plain, read_note(run.path)), *shown.run.on_sampling, *shown.left_out, *shown.remarks]
                texts, edited = read_texts(shown.run)
                tables = tables_of(shown, None)
                material = RunMaterial(collection=shown, texts=texts, edited=edited, tables=tables, remarks=remarks)
            known = _Reading(seen=seen, is_finished=is_finished, is_busy=is_busy, material=material)
            self._readings[run.path] = known
        return known

    def _collected(self, run: RunDirectory, *, is_finished: bool) -> Collection | None:
        """Read a run, with its studies once it is finished; None before its first generation has ended."""
        if is_finished:
            return collect(run.path, self._store)
        begun = load_begun(run.path, self._store) if (run.path / "run.json").exists() else None
        if begun is None:
            return None
        return Collection(run=begun[0], niches=begun[1], studies=(), reestimates=(), left_out=())

    def _compared(self) -> tuple[dict[str, Any] | None, str]:
        """Compare the arms of the finished jobs; or return why not."""
        try:
            return sweep_contents(collect_sweep(self._path, self._store)), ""
        except (TacevoError, OSError) as error:
            return None, f" The arms are not compared yet: {error}"


def _state_of(file: Path) -> object:
    with contextlib.suppress(OSError):
        state = file.stat()
        return str(file), state.st_mtime_ns, state.st_size
    return None
