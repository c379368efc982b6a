"""The mirror's work: reads a run directory and writes it into MLflow.

What it promises: it only reads the run; done twice, or killed and done again, it writes nothing twice. What it
does not: it takes the ledger's lines as they stand; to check their chain is the ledger's business.
"""

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tacevo.costs import Spending, total
from tacevo.records import Json
from tacevo.rundir import RunDirectory
from tacevo.store import content_hash
from tacevo.tracking.entries import (
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
)
from tacevo.tracking.writer import SearchWriter, find_or_create_experiment, open_store


def mirror(run_dir: Path, *, uri: str, experiment: str, finished: Callable[[], bool]) -> None:
    """Write a run into MLflow, and follow it until it is finished.

    The parent run ends as `FINISHED`, tagged with the digest, where `run.json` holds the digest of the ledger's
    last line, else as `KILLED`. A mirror of the same directory that is still at work is waited for.

    Args:
        run_dir: the run directory; nothing is written there.
        uri: an MLflow tracking URI; `sqlite:///` with a relative path starts from the working directory.
        experiment: the name of the MLflow experiment.
        finished: says that no more lines will come; asked before each look at the ledger, so the time it takes
            to answer sets the pace.

    Raises:
        OSError: the run directory cannot be read, or the folder of a SQLite database cannot be made.
        MlflowException: the store cannot be written.
    """
    with _alone(run_dir):
        lines = follow(run_dir / "ledger.jsonl", finished)
        header = next(lines, None)
        if header is None:
            return
        facts = _facts(run_dir)
        client = open_store(uri)
        writer = SearchWriter(
            client,
            find_or_create_experiment(client, experiment),
            key=content_hash([header["hash"], run_dir.resolve().name]),
            name=facts["name"],
        )
        writer.write_params(config_params(facts["config"]))
        last = header["hash"]
        costs = _Costs(run_dir)
        for line in lines:
            _write_line(writer, run_dir, facts, line, costs)
            last = line["hash"]
        writer.end(last if _facts(run_dir)["digest"] == last else None)


def follow(path: Path, finished: Callable[[], bool]) -> Iterator[dict[str, Json]]:
    """Give a ledger's whole lines as they are committed, until `finished`; the file may not exist yet."""
    offset = 0
    ended = False
    while not ended:
        ended = finished()  # asked before reading: what was committed before the end is still read
        whole = _whole_lines(path, offset)
        offset += len(whole)
        for text in whole.splitlines():
            yield json.loads(text)


class _Costs:
    """What the candidates' answers cost, from the run directory, where they stand before the ledger's lines."""

    def __init__(self, run_dir: Path) -> None:
        self._directory = RunDirectory(run_dir)
        self._known: dict[str, Spending] = {}
        self._generation: list[Spending] = []

    def of_candidate(self, name: str) -> Spending:
        """Give a candidate's; the file is read again only for one that is new."""
        if name not in self._known:
            self._known = self._directory.read_spending()
        self._generation.append(self._known.get(name, Spending()))
        return self._generation[-1]

    def of_generation(self) -> Spending:
        """Add up the candidates since the last generation."""
        spent, self._generation = total(self._generation), []
        return spent


def _write_line(
    writer: SearchWriter, run_dir: Path, facts: dict[str, Json], line: dict[str, Json], costs: _Costs
) -> None:
    if line["kind"] == "generation":
        spent = cost_measures(costs.of_generation(), line["generation"])
        writer.write_generation((*generation_measures(line), *spent))
    elif line["kind"] == "candidate":
        writer.write_candidate(
            line["id"],
            candidate_params(line, facts["task"]["instructions"]),
            (*candidate_measures(line), *cost_measures(costs.of_candidate(line["id"]), 0)),
            run_dir / "candidates" / f"{line['id']}.py",
            failed="stage" in line,
        )


def _whole_lines(path: Path, offset: int) -> bytes:
    if not path.exists():
        return b""
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read()
    return data[: data.rfind(b"\n") + 1]  # a line without its end is not committed yet


def _facts(run_dir: Path) -> dict[str, Json]:
    facts: dict[str, Json] = json.loads((run_dir / "run.json").read_text(encoding="utf-8"))
    return facts


@contextmanager
def _alone(run_dir: Path) -> Iterator[None]:
    """Wait until no other process mirrors the directory, and keep others waiting."""
    handle = os.open(run_dir, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
