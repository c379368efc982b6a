"""The mirror's work: reads a run directory and writes it into MLflow.

What it promises: but for the id of the folder it only reads the run; done twice, or killed and done again, it writes
nothing twice. What it does not: it takes the ledger's lines as they stand; to check their chain is the ledger's
business.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

from tacevo.costs import Spending, total
from tacevo.records import to_json
from tacevo.search.lines import CandidateLine, GenerationLine, Line, line_kind
from tacevo.storage.canonical import content_hash
from tacevo.storage.files import alone
from tacevo.storage.ledger import read_line
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.tracking.client import find_or_create_experiment, open_store
from tacevo.tracking.datasets import data_set, source_tags
from tacevo.tracking.entries import (
    Measure,
    Totals,
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
    total_measures,
)
from tacevo.tracking.identity import folder_id
from tacevo.tracking.sweeps import Membership, leave_sweep, membership, nest
from tacevo.tracking.writer import Entry, SearchWriter


def mirror(run_dir: Path, *, uri: str, experiment: str, finished: Callable[[], bool] | None) -> None:
    """Write a run into MLflow, as it stands or until it is finished.

    The search's run ends as `FINISHED`, tagged with the digest, where `run.json` holds the digest of the ledger's
    last line, else as `KILLED`. A run that is a job of a sweep is nested under the sweep's, which ends with its last
    job.

    Args:
        run_dir: the run directory; nothing is written there but its id.
        uri: an MLflow tracking URI; `sqlite:///` with a relative path starts from the working directory.
        experiment: the name of the MLflow experiment.
        finished: says that no more lines will come; asked before each look at the ledger, so the time it takes
            to answer sets the pace. Another mirror of the directory is waited for. None writes what stands there now:
            another mirror is not waited for, and a search that is at work is left `RUNNING`.

    Raises:
        RunError: the folder of the run's sweep, or its id, is damaged; or another mirror of the directory is at work.
        OSError: the run directory cannot be read, or the folder of a SQLite database cannot be made.
        MlflowException: the store cannot be written.
    """
    ledger = run_dir / "ledger.jsonl"
    with alone(run_dir, wait=finished is not None):
        lines = follow(ledger, finished or _at_once)
        header = next(lines, None)
        if header is None:
            return
        facts = _facts(run_dir)
        member = membership(run_dir)
        client = open_store(uri)
        place = find_or_create_experiment(client, experiment)
        writer = SearchWriter(
            client,
            place,
            key=_key(run_dir, header[1], member),
            name=facts.name,
            source=source_tags(to_json(facts)),
            ledger=frozenset(own for _, own in follow(ledger, _at_once)),
        )
        if member is not None:
            nest(client, place, member, writer.tag)
        writer.write_params(config_params(facts.config))
        writer.write_data(data_set(to_json(facts)))
        last = header[1]
        sums = _Sums(run_dir)
        for line, last in lines:
            _write_line(writer, run_dir, facts, (line, last), sums)
        if _facts(run_dir).digest == last:
            writer.finish(last)
        elif finished is not None or not RunDirectory(run_dir).is_busy:
            writer.stop()
        if member is not None:
            leave_sweep(client, place, member)


def follow(path: Path, finished: Callable[[], bool]) -> Iterator[tuple[Line, str]]:
    """Yield a ledger's whole lines, each with its hash, as they are committed, until `finished`.

    The file may not exist yet.
    """
    offset = 0
    ended = False
    while not ended:
        ended = finished()  # asked before reading: what was committed before the end is still read
        whole = _whole_lines(path, offset)
        offset += len(whole)
        for text in whole.splitlines():
            line: Line
            line, _, own = read_line(text, line_kind, str(path))
            yield line, own


class _Sums:
    """What adds up over a search: its costs, which stand in the run directory before the ledger's lines, and more."""

    def __init__(self, run_dir: Path) -> None:
        self._directory = RunDirectory(run_dir)
        self._known: dict[str, Spending] = {}
        self._generation: list[Spending] = []
        self._totals = Totals()

    def of_candidate(self, name: str) -> Spending:
        """Give a candidate's cost; the file is read again only for one that is new."""
        if name not in self._known:
            self._known = self._directory.read_spending()
        self._generation.append(self._known.get(name, Spending()))
        return self._generation[-1]

    def of_generation(self, line: GenerationLine) -> tuple[Measure, ...]:
        """Give what the candidates since the last generation cost, and how far the search has come with them."""
        spent, self._generation = total(self._generation), []
        self._totals = self._totals.after(line, spent)
        return (*cost_measures(spent, line.generation), *total_measures(self._totals, line))


def _key(run_dir: Path, header: str, member: Membership | None) -> str:
    """Name a search: by its folder's id or, where none can be written, by the names of its folder and its sweep's."""
    own = folder_id(run_dir)
    names = [run_dir.resolve().name, *([] if member is None else [member.name])]
    return content_hash([header, *(names if own is None else [own])])


def _at_once() -> bool:
    """Say that no more lines are waited for."""
    return True


def _write_line(writer: SearchWriter, run_dir: Path, facts: RunRecord, recorded: tuple[Line, str], sums: _Sums) -> None:
    line, own = recorded
    if isinstance(line, GenerationLine):
        writer.write_generation(own, (*generation_measures(line), *sums.of_generation(line)))
    elif isinstance(line, CandidateLine):
        writer.write_candidate(
            Entry(name=line.id, line=own, failed=line.stage is not None),
            candidate_params(line, facts.task.instructions),
            (*candidate_measures(line), *cost_measures(sums.of_candidate(line.id), 0)),
            run_dir / "candidates" / f"{line.id}.py",
        )


def _whole_lines(path: Path, offset: int) -> bytes:
    if not path.exists():
        return b""
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read()
    return data[: data.rfind(b"\n") + 1]  # a line without its end is not committed yet


def _facts(run_dir: Path) -> RunRecord:
    return RunDirectory(run_dir).read_run()
