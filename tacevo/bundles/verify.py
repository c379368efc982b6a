"""Whether the records of a published run or sweep follow from each other: searches, studies, tables, a sweep's jobs.

Nothing in a bundle is believed, and no code of a candidate runs. What cannot be made again from the records (figures,
which depend on fonts and libraries, and the pages that describe the bundle) is compared with its checksum only.
"""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path

from tacevo.bundles.format import refusing
from tacevo.bundles.open import Opened
from tacevo.bundles.texts import check_texts
from tacevo.environment import doubting
from tacevo.errors import BundleError, DivergenceError, RunError
from tacevo.reproduce.replay import Replayed, replay
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import FinishedStudy, study_names
from tacevo.results.summary import summarise
from tacevo.results.sweep_jobs import check_jobs
from tacevo.rules import PAGES
from tacevo.runs.progress import Progress
from tacevo.storage.run_directory import PARTS
from tacevo.storage.store import Seen
from tacevo.storage.sweep_directory import SweepDirectory, naming
from tacevo.studies.study import replay_studies


@dataclass(frozen=True, slots=True, kw_only=True)
class Rerun:
    """A run whose search and studies were run again, and found to be as recorded."""

    run: RecordedRun
    replayed: Replayed
    #: The run's finished studies, by name.
    studies: Mapping[str, FinishedStudy]

    @property
    def pages(self) -> int:
        """Number of the summary, which was compared where it is the current one (`tacevo.rules.PAGES`)."""
        return self.run.record.pages


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """A run or a sweep that was run again, and found to be as recorded; of a bundle, with all that is beside it."""

    #: The run that was made again, or those of a sweep's jobs in their order.
    runs: tuple[Rerun, ...]
    #: Store entries of a bundle, all of which were read; None of a directory, and of one job of a bundle.
    entries: int | None = None
    #: Files of tables that were made again, and are equal.
    tables: int = 0
    #: Files of tables that cannot be made here, because a part is not installed: their checksums were right.
    unmade: int = 0
    #: Files of tables that another release wrote (`tacevo.rules.PAGES`): their checksums were right.
    older: int = 0
    #: Files of figures: their checksums were right.
    figures: int = 0


def verify(
    bundle: Opened,
    make_tables: Callable[[Path, Sequence[Rerun]], Mapping[str, bytes]],
    view: Progress,
    *,
    can_make: Callable[[str], bool] = bool,
    trusts: bool = False,
) -> Verified:
    """Replay a bundle from its own store entries, and compare everything that follows from them.

    Tables, by their file names, are made from the directory of a run or a sweep, and from what was read of its runs;
    those that cannot be made here, because a part is not installed, are not compared.

    Raises:
        DivergenceError: the first difference: a ledger line, an archive, a candidate's file, a score, a table's line, a
            job that is not what sweep.json says.
        BundleError: its records do not suit each other, or hold something that no run writes.
    """
    assert bundle.root is not None  # of a directory, nothing is compared that a manifest would list
    read: set[Path] = set()
    with refusing():
        runs = rerun_all(bundle, lambda run: rerun_published(bundle, run, view, seen=read.add, trusts=trusts), view)
        _check_entries(bundle.store, read)
        tables = files_below(bundle.root / "tables")
        if current := all(run.pages == PAGES for run in runs):
            made = make_tables(bundle.folder, runs)
            there = {name: content for name, content in tables.items() if can_make(name)}
            compare_tables(there, {name: content for name, content in made.items() if can_make(name)})
    return Verified(
        runs=runs,
        entries=len(read),
        tables=len(there) if current else 0,
        unmade=len(tables) - len(there) if current else 0,
        older=0 if current else len(tables),
        figures=len(files_below(bundle.root / "figures")),
    )


def rerun_published(
    bundle: Opened, run: Path, view: Progress, *, seen: Seen | None = None, trusts: bool = False
) -> Rerun:
    """Run one run of a bundle again, as `rerun`; nothing in its records is believed.

    Raises:
        DivergenceError: as `rerun`.
        BundleError: its records do not suit each other, or hold something that no run writes.
    """
    with refusing():
        checked = rerun(bundle.read(run), view, seen=seen, trusts=trusts)
        _check_files(run, checked)
        check_texts(checked.run, checked.studies.values())
        return checked


def rerun_all(place: Opened, again: Callable[[Path], Rerun], view: Progress) -> tuple[Rerun, ...]:
    """Run every search and its studies again, by `again`; of a sweep, compare its list of jobs with them, too.

    Lines and errors of a sweep name the job.
    """
    if place.jobs is None:
        return (again(place.folder),)
    done = []
    for number, (job, run) in enumerate(zip(place.jobs, place.runs, strict=True), start=1):
        view.say(f"job {job} ({number} of {len(place.jobs)})")
        with naming(job):
            done.append(again(run))
    check_jobs(SweepDirectory(place.folder))
    return tuple(done)


def rerun(run: RecordedRun, view: Progress, *, seen: Seen | None = None, trusts: bool = False) -> Rerun:
    """Run a search and its studies again, and compare all of its own files; `seen` gets every store entry that is read.

    `trusts` is as of `replay`.

    Raises:
        TacevoError: as `replay`, `replay_studies`, `check_sizes` and `check_records`.
    """
    check_sizes(run)
    if run.stores_found:
        view.say(run.stores_found)
    replayed = replay(run, view, seen=seen, trusts=trusts)
    studies = replay_studies(run, view, seen=seen)
    with doubting(run.record.versions):  # a summary is its version's
        check_records(run, replayed)
    for study in studies.values():
        _check_name(study, searched=bool(run.answered))
    return Rerun(run=run, replayed=replayed, studies=studies)


def check_sizes(run: RecordedRun) -> None:
    """Check that a run has as many candidates and trainings as its configuration says.

    Otherwise a few digits could ask for more memory than there is.
    """
    search, lines = run.config.search, len(run.ledger.lines)
    generations = search.generations
    # A ledger that lies about what was spent differs from its replay before the generation that it lacks is planned.
    if search.training_flops is not None and run.training_flops >= search.training_flops:
        generations = min(len(run.generations) - 1, generations)
    expected = 1 + (1 + search.initial + 1) + generations * (search.candidates + 1)
    if lines != expected:
        raise RunError(f"{lines}", place=str(run.directory.ledger), expected=f"{expected} lines, by run.json")


def check_records(run: RecordedRun, replayed: Replayed) -> None:
    """Compare the costs and the summary of a run with its replay; the summary only if it is of this release."""
    remedy = "the command that began the run writes it again"
    path = run.directory.path
    for name, spent in sorted(run.spent.items()):
        if (computed := replayed.spending.get(name)) != spent:
            place = f"{path}/timings.jsonl, {name}"
            raise DivergenceError(f"{spent}", place=place, expected=f"what its answers cost, {computed}", remedy=remedy)
    if run.record.pages != PAGES:
        return
    path = path / "summary.md"
    recorded = path.read_text(encoding="utf-8") if path.exists() else ""
    if (difference := _first_line(recorded, summarise(run))) is not None:
        raise DivergenceError(difference, place=str(path), remedy=remedy)


def _check_name(study: FinishedStudy, *, searched: bool) -> None:
    """Check the name of a study; tables and figures of it bear that name."""
    names = study_names(study.header, searched=searched)
    if study.path.name not in names or study.record.name != study.path.name:
        raise DivergenceError(
            f"{study.path.name} and {study.record.name!r}",
            place=f"{study.path} and the name in its study.json",
            expected=f"{names[0]}, which follows from its scores",
        )


def compare_tables(there: Mapping[str, bytes], made: Mapping[str, bytes]) -> None:
    """Compare tables with those that were made again; the error names table and line of the first difference."""
    for name in sorted(there.keys() ^ made.keys()):
        got = "one that does not follow from the records" if name in there else "none"
        raise DivergenceError(got, place=f"table {name}", expected="the tables of this release")
    for name, content in sorted(made.items()):
        if (different := table_difference(there[name], content)) is not None:
            raise DivergenceError(different, place=f"table {name}")


def files_below(folder: Path, prefix: str = "") -> dict[str, bytes]:
    """Return the contents of the files below a directory of a bundle, by their place in it."""
    files: dict[str, bytes] = {}
    for path in folder.iterdir():
        inner = f"{prefix}{path.name}"
        files |= files_below(path, f"{inner}/") if path.is_dir() else {inner: path.read_bytes()}
    return files


def table_difference(recorded: bytes, made: bytes) -> str | None:
    """Name the first line in which two files of one table differ; None where they are equal."""
    if recorded == made:
        return None
    was, now = (content.decode("utf-8", errors="replace") for content in (recorded, made))
    return _first_line(was, now) or "its bytes are not UTF-8"


def _first_line(was: str, now: str) -> str | None:
    """Name the first line that differs."""
    old, new = was.split("\n"), now.split("\n")
    for number, (left, right) in enumerate(zip(old, new, strict=False), start=1):
        if left != right:
            return f"line {number}: recorded {left[:200]!r}, replayed {right[:200]!r}"
    return None if len(old) == len(new) else f"recorded {len(old)} lines, replayed {len(new)}"


def _check_files(run: Path, checked: Rerun) -> None:
    """Check that a run has no candidate or study beside those that were compared."""
    kept = {
        "the ledger": ({path.name for path in run.glob("candidates/*")}, checked.replayed.files),
        "a study of this run": ({path.name for path in run.glob("studies/*")}, checked.studies.keys()),
        "a part that decided": ({path.name for path in run.glob(f"{PARTS}/*")}, checked.run.config.code.keys()),
    }
    for what, (there, known) in kept.items():
        for name in sorted(there - known):
            raise BundleError(name, place=str(run), expected=f"only files of {what}")


def _check_entries(store: Path, read: Set[Path]) -> None:
    """Check that every store entry of a bundle was needed by a run of it."""
    for path in sorted(set(store.glob("*/*/*.json")) - read):
        raise BundleError(path.name, place=str(store), expected="only entries that the replay reads")
