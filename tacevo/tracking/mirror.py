"""The mirror's work: reads a run directory and writes it, with its studies, into MLflow.

What it promises: it only reads the run directory; done twice, or killed and done again, it writes nothing twice. What
it does not: it takes the ledger's lines as they stand, and does not check their chain.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from tacevo.costs import Spending, total
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import Line, line_kind
from tacevo.records import Operator
from tacevo.storage.ledger import read_line
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.tracking.data_and_code import data_set, search_tags, shown_config, source_tags
from tacevo.tracking.lock import alone
from tacevo.tracking.mlflow_store import PARENT_TAG, find_or_create_experiment, open_store
from tacevo.tracking.params import (
    Totals,
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
)
from tacevo.tracking.sweep_run import SWEEP_TAG, find_sweep, join_sweep, leave_sweep
from tacevo.tracking.writer import SearchWriter, search_key


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
        record, sweep = directory.read_run(), find_sweep(run_dir)
        client = open_store(uri)
        place = find_or_create_experiment(client, experiment)
        nesting = {} if sweep is None else join_sweep(client, place, *sweep)
        name = run_dir.resolve().name
        writer = SearchWriter(
            client,
            place,
            key=search_key(header[0], name, nesting.get(SWEEP_TAG, "")),
            name=name,
            tags={**search_tags(record), **nesting},
            source=source_tags(record.code),
        )
        writer.write_params(config_params(shown_config(record)))
        writer.write_data(data_set(record))
        last = _write_lines(writer, lines, directory, record) or header[0]
        is_whole = directory.read_run().digest == last
        if is_whole:
            writer.finish(last, run_dir)
        elif finished is not None or not directory.is_busy:
            writer.stop()
        if sweep is not None:
            leave_sweep(client, nesting[PARENT_TAG], sweep[0])
        if is_whole:  # last, because a damaged study is no reason to leave the search open
            from tacevo.tracking.findings import write_findings  # the analysis needs memory, too, while a search works

            write_findings(writer, directory)


def _write_lines(
    writer: SearchWriter, lines: Iterable[tuple[str, Line]], directory: RunDirectory, record: RunRecord
) -> str:
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
            params = candidate_params(line, record.task.instructions)
            measures = (*candidate_measures(line), *cost_measures(generation[-1], 0))
            writer.write_candidate(line, last, params, measures, directory.path / "candidates" / f"{line.id}.py")
        elif isinstance(line, GenerationLine):
            spent, generation = total(generation), []
            figures = generation_measures(line, baseline=baseline, trivial=record.trivial)
            costs = cost_measures(spent, line.generation)
            writer.write_generation(line.generation, (*figures, *costs, *totals.after(line, spent)))
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
