"""What `tacevo rm` may remove: the directory of a run or a sweep that nobody is at work in and nobody else needs."""

import contextlib
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from tacevo.errors import RunError
from tacevo.storage.files import in_use
from tacevo.storage.run_directory import MANIFEST, RunDirectory, runs_below
from tacevo.storage.store import KINDS
from tacevo.storage.sweep_directory import SweepDirectory

#: The entries of a kind in stores; `studies` of a run is no such kind.
_ENTRIES = "[0-9a-f][0-9a-f]/*.json"


@contextlib.contextmanager
def removable(path: Path) -> Iterator[Callable[[], None]]:
    """Hold a run or a sweep, with its studies, so that no process begins to work in it.

    Yields:
        What removes it. Its answers stay in the stores.

    Raises:
        RunError: it is not the directory of a run or a sweep; a process is at work in it; or a sweep, or other runs,
            need it.
    """
    sweep = SweepDirectory(path)
    own = [sweep.run(job).path for job in sweep.read().jobs] if sweep.is_one else [path]
    _check_kind(path, is_sweep=sweep.is_one)
    _check_others(path, own)
    with ExitStack() as held:
        for run in (each for each in own if each.is_dir()):
            held.enter_context(RunDirectory(run).locked())
            for folder in (run, *run.glob("studies/*/")):
                held.enter_context(in_use(folder, alone=True))
        if sweep.is_one:
            held.enter_context(sweep.locked())
        yield lambda: _remove(path)


def _check_kind(path: Path, *, is_sweep: bool) -> None:
    """Refuse what is not the directory of a run or a sweep of this user's."""
    got = ""
    if path.is_symlink():
        got, remedy = f"a link to {path.resolve()}", "name the directory itself"
    elif path.is_file():
        got, remedy = "a file, such as a published run", "remove it by `rm`"
    elif (path / MANIFEST).exists() or (path.resolve().parent / MANIFEST).exists():
        got, remedy = "a published run that was unpacked", "remove it by `rm -r`"
    elif not is_sweep and not ((path / "run.json").is_file() and (path / "ledger.jsonl").is_file()):
        got, remedy = "a directory without run.json and ledger.jsonl, or none", "`tacevo search` prints a run's"
    if got:
        raise RunError(got, place=str(path), expected="the directory of a run or a sweep", remedy=remedy)


def _check_others(path: Path, own: list[Path]) -> None:
    """Refuse what a sweep, other runs or this shell need."""
    whole, got, remedy = path.resolve(), "", "move these elsewhere first"
    above = SweepDirectory(whole.parent)
    if above.is_one and whole.name in {job.name for job in above.read().jobs}:
        got, remedy = f"a job of the sweep {path.parent}, whose tables need it", "remove the whole sweep"
    elif Path.cwd().is_relative_to(whole):
        got, remedy = "the directory that this command was started in", "start it in another one"
    elif others := [run for run in runs_below(path) if run not in own]:
        got = f"one that holds another run, {others[0]}"
    elif stores := [place.parent for kind in KINDS for place in path.rglob(kind) if any(place.glob(_ENTRIES))]:
        got = f"one that holds the stores {stores[0]}, which other runs may need"
    if got:
        raise RunError(got, place=str(path), expected="a run or a sweep that nothing else needs", remedy=remedy)


def _remove(path: Path) -> None:
    """Remove a directory: first its name, so that what a killed process leaves is not taken for a run."""
    gone = path.with_name(f".{path.name}.{secrets.token_hex(8)}.removed")
    path.rename(gone)
    shutil.rmtree(gone)
