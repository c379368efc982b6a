"""Brings MLflow level with a run directory: reads what stands there, and writes what the store lacks.

What it promises: it only reads the run directory; done twice, or killed and done again, it writes nothing twice. What
it does not: it takes the ledger's lines as they stand, and does not check their chain.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from tacevo.costs import Spending, total
from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import Line, line_kind
from tacevo.records import Operator
from tacevo.storage.canonical import content_hash
from tacevo.storage.files import flock
from tacevo.storage.ledger import read_line
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.storage.sweep_directory import Job, SweepDirectory
from tacevo.tracking.shown import (
    EVERY_GENERATION,
    Totals,
    config_params,
    cost_measures,
    data_set,
    generation_measures,
    search_tags,
    shorten,
    shown_candidate,
    shown_config,
    source_tags,
)
from tacevo.tracking.store import PARENT_TAG, Search, Store

#: The tags of a sweep: what it is found by; its name, arm and seed are tags of its searches, too.
_SWEEP_KEY_TAG, SWEEP_TAG, _ARM_TAG, _SEED_TAG = "tacevo.sweep_key", "tacevo.sweep", "tacevo.arm", "tacevo.seed"


def mirror(run_dir: Path, *, uri: str, experiment: str, finished: Callable[[], bool] | None) -> None:
    """Write a run into MLflow, as it stands or until it is finished.

    The search's run ends as `FINISHED`, tagged with the digest, where `run.json` holds the digest of the ledger's
    last line, else as `KILLED`. A run that is a job of a sweep is nested under the sweep's run, and the finished
    studies of a finished search under the search's.

    A tracking URI that is `sqlite:///` with a relative path starts from the working directory. `finished` says whether
    no more lines will come; it is asked before each look at the ledger, so the time it takes to answer sets the pace,
    and another mirror of the directory is waited for. None writes what stands there now: another mirror is not waited
    for, and a search that is at work is left `RUNNING`.

    Raises:
        RunError: run.json, a ledger line or sweep.json is damaged; the store holds another search under this name; its
            experiment was deleted; or another mirror of the directory is at work.
        OSError: the run directory cannot be read, or the directory of a SQLite database cannot be created.
        MlflowException: the store cannot be written.
    """
    directory = RunDirectory(run_dir)
    with alone(run_dir, wait=finished is not None):
        lines = follow(directory.ledger, finished or (lambda: True))
        header = next(lines, None)
        if header is None:
            return
        record, job, name = directory.read_run(), find_job(run_dir), run_dir.resolve().name
        store = Store.open(uri, experiment)
        nesting = {} if job is None else join_sweep(store, *job)
        search = Search(
            store,
            # Found by the hash of its ledger's first line, and the names of run and sweep.
            key=content_hash([header[0], name, nesting.get(SWEEP_TAG, "")]),
            name=name,
            tags={**search_tags(record), **nesting},
            source=source_tags(record.code),
        )
        search.write_params(config_params(shown_config(record)))
        search.write_data(data_set(record))
        last = _write_lines(search, lines, directory, record) or header[0]
        is_whole = directory.read_run().digest == last
        if is_whole:
            search.finish(last, run_dir)
        elif finished is not None or not directory.is_busy:
            search.stop()
        if job is not None:
            _leave_sweep(store, nesting[PARENT_TAG], job[0])
        if is_whole:  # last, because a damaged study is no reason to leave the search open
            from tacevo.tracking.findings import write_findings  # the analysis needs memory, too, while a search works

            write_findings(search, directory)


def _write_lines(search: Search, lines: Iterable[tuple[str, Line]], directory: RunDirectory, record: RunRecord) -> str:
    """Write candidates and generations as their lines come; return the hash of the last line, empty without any."""
    last, totals, baseline = "", Totals(), None
    known: dict[str, Spending] = {}
    generation: list[Spending] = []
    for last, line in lines:
        if isinstance(line, CandidateLine):
            if line.id not in known:  # costs are written before the ledger's line
                known = directory.read_spending()
            generation.append(known.get(line.id, Spending()))
            baseline = line.fitness if line.operator is Operator.baseline else baseline
            path = directory.path / "candidates" / f"{line.id}.py"
            source = path.read_text(encoding="utf-8", errors="replace") if path.exists() else None
            search.add(shown_candidate(line, last, record.task.instructions, generation[-1], source))
        elif isinstance(line, GenerationLine):
            spent, generation = total(generation), []
            figures = generation_measures(line, baseline=baseline, trivial=record.trivial)
            points = (*figures, *cost_measures(spent, line.generation), *totals.after(line, spent))
            search.add_points(points, known_by=EVERY_GENERATION)
    return last


def follow(path: Path, finished: Callable[[], bool]) -> Iterator[tuple[str, Line]]:
    """Yield hash and record of a ledger's lines as they are committed, until `finished`; the file may not exist yet.

    Raises:
        RunError: a line is damaged.
    """
    offset, ended = 0, False
    while not ended:
        ended = finished()  # asked before reading: what was committed before the end is still read
        data = b""
        with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
            file.seek(offset)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]  # a line without its end is not committed yet
        offset += len(whole)
        for text in whole.splitlines():
            line: Line
            line, _, own = read_line(text, line_kind, str(path))
            yield own, line


@contextlib.contextmanager
def alone(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Keep other mirrors out of a directory; by default, wait for the one at work there, as long as it takes.

    What two processes wrote into MLflow at once would be there twice. Nothing is written: the directory itself is
    locked. A file system without locks, or one across a network that cannot lock directories, keeps no process out.

    Raises:
        RunError: another process is at work there, and `wait` is False.
        OSError: the directory does not exist.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # no locks here
            if not flock(handle, wait=wait):
                got = "one that its search or another `tacevo track` is mirroring"
                remedy = "repeat the command when that is done"
                raise RunError(got, place=str(folder), expected="an idle run", remedy=remedy)
        yield
    finally:
        os.close(handle)


def find_job(run_dir: Path) -> tuple[SweepDirectory, Job] | None:
    """Find the sweep of which a run is a job, and that job: the directory above, if its sweep.json lists the run.

    Raises:
        RunError: sweep.json is damaged.
    """
    path = run_dir.resolve()
    directory = SweepDirectory(path.parent)
    jobs = directory.read().jobs if directory.is_one else ()
    return next(((directory, job) for job in jobs if job.name == path.name), None)


def join_sweep(store: Store, directory: SweepDirectory, job: Job) -> dict[str, str]:
    """Find or create the run of a sweep, as running; return the tags that nest the search of a job under it."""
    sweep, name = directory.read(), directory.path.name
    key = content_hash([name, sweep.jobs[0].config])  # jobs are only added, so the first one stays
    with alone(directory.path):  # jobs that start at the same moment share the sweep's run
        run = store.find_or_create(tag=_SWEEP_KEY_TAG, key=key, name=name)
        parent: str = run.info.run_id
        if "overrides" not in run.data.params:
            store.client.set_tag(parent, SWEEP_TAG, name)
            store.log(parent, {"overrides": shorten(" ".join(sweep.overrides))}, ())
    store.client.update_run(parent, status="RUNNING")
    return {PARENT_TAG: parent, SWEEP_TAG: name, _ARM_TAG: job.arm, _SEED_TAG: str(job.seed)}


def _leave_sweep(store: Store, sweep: str, directory: SweepDirectory) -> None:
    """End the run of a sweep if all of its jobs are finished, including those that were added meanwhile."""
    if all((directory.path / job.name / "summary.md").exists() for job in directory.read().jobs):
        store.client.set_terminated(sweep, "FINISHED")
