"""The commands `tacevo cache ...`."""

from collections.abc import Sequence
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, agreed, existing_store, tell
from tacevo.reproduce.entry_files import import_file, write_entries
from tacevo.reproduce.prune import unused
from tacevo.runs.progress import Progress
from tacevo.storage.files import remove_leftovers
from tacevo.storage.listing import describe_entries, verify
from tacevo.text import counted


def verify_entries(store: Path) -> int:
    """Check every entry of a store."""
    problems, files = verify(store)
    for problem in problems:
        tell(problem)
    tell(f"{files - len(problems)} of {files} entries are sound")
    return DIFFERENT if problems else DONE


def prune_entries(folders: Sequence[Path], store: str, *, yes: bool) -> int:
    """Remove the entries that no run below some folders needs, after a question."""
    root = Path(existing_store(store) or "")
    remove_leftovers(root)  # also of earlier releases, which began an entry beside its place
    with Progress() as view:
        files, runs = unused(root, folders, view)
    if not files:
        tell(f"every entry of {root} is needed by {counted(runs, 'run')}")
        return DONE
    tell(f"{describe_entries(root, files)}: {counted(runs, 'run')} here need none of these, a run elsewhere may")
    if not agreed(f"remove {counted(len(files), 'file')} from {root}?", yes):
        return DIFFERENT
    for file in files:
        file.unlink(missing_ok=True)
    tell(f"removed: {counted(len(files), 'file')}; images stay in {root / 'data'}, and are made again where they lack")
    return DONE


def export_entries(run: Path, file: Path, store: str | None) -> int:
    """Write the entries that a run needs into a file."""
    with Progress() as view:
        entries = write_entries(run, file, store, view)
    tell(f"{entries} entries are in {file}")
    return DONE


def import_entries(file: Path, store: Path) -> int:
    """Write the entries of a file into a store, once they are verified."""
    written, standing, passed_over = import_file(file, store)
    tell(f"{written} entries written, {standing} were there already")
    if passed_over:
        tell(f"{passed_over} passed over: files of candidates, and full trainings without their test predictions")
    return DONE
