"""Replay: a recorded search run again from its stores alone, and held against every line and file of it."""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.choices import DataSource
from tacevo.composition import from_plain
from tacevo.config import RunConfig, StoreConfig
from tacevo.costs import Spending, spending_on, total
from tacevo.development import Outcome
from tacevo.documents import archive_files, as_recorded, run_header
from tacevo.errors import CacheMissError, ConfigError, DivergenceError, RunError
from tacevo.ledger import Ledger
from tacevo.progress import View, Watcher
from tacevo.proposals import Instruction, Task
from tacevo.records import Contract, DataFacts, Json, Mode, Rejection
from tacevo.rundir import RunDirectory, deviations, rejected_text, versions
from tacevo.search import Plan, SearchState, run_search
from tacevo.store import Seen, differences, shown, value_at
from tacevo.wiring import build_plan, open_tools


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """A run that was found to be as recorded."""

    digest: str
    #: Ledger lines that were compared.
    lines: int
    #: What the recorded answers of each candidate cost when they were had; the replay itself asks nobody.
    spending: Mapping[str, Spending]
    #: Names of the candidates' files that were compared.
    files: frozenset[str]

    @property
    def spent(self) -> Spending:
        """What all of them cost."""
        return total(self.spending.values())


def replay(path: Path, store: str | None, view: View, *, seen: Seen | None = None) -> Replayed:
    """Run a recorded search again from its stores alone, and compare every line and file of it.

    Neither the data set nor a model nor a sandbox is used.

    Args:
        path: the run directory.
        store: where the stores lie, if not where the run had them.
        view: who is told.
        seen: told of every store entry that the replay reads, from any thread.

    Raises:
        DivergenceError: something recorded differs from what the search gives.
        CacheMissError: a store lacks an answer.
        RunError: this is no run directory, or its ledger is damaged.
    """
    directory = RunDirectory(path)
    with directory.believed():
        others = deviations(directory.read_run()["versions"], versions())
    for other in others:
        view.say(f"another version: {other}")
    with doubting(others):
        return _replay(directory, store, view, seen)


def _replay(directory: RunDirectory, store: str | None, view: View, seen: Seen | None) -> Replayed:
    """Run the search again, and compare."""
    config, task, facts = read_run(directory, store)
    recorded = directory.read_finished()
    plan = as_recorded(build_plan(config, task, Mode.replay, seen=seen), recorded)
    with Ledger(None, recorded) as ledger, open_tools(config, task, facts, None, Mode.replay, seen=seen) as tools:
        ledger.commit(run_header(config, task, facts, plan))
        verifier = _Verifier(directory, plan, view)
        state = run_search(plan, tools, ledger, verifier)
        if ledger.committed != len(recorded):
            raise DivergenceError(f"the ledger has {len(recorded)} lines; the search gives {ledger.committed}")
        _compare_files(directory, plan, state)
        return Replayed(
            digest=ledger.digest,
            lines=ledger.committed,
            spending=verifier.spending,
            files=frozenset(verifier.files),
        )


@contextlib.contextmanager
def doubting(others: Sequence[str]) -> Iterator[None]:
    """Say beside a failure of a replay which versions are others; where none is, it stays as it is."""
    try:
        yield
    except (CacheMissError, ConfigError, DivergenceError) as error:
        if not others:
            raise
        raise type(error)(f"{error}; this may come of another version: {', '.join(others)}") from error


def read_run(directory: RunDirectory, store: str | None = None) -> tuple[RunConfig, Task, DataFacts]:
    """Read a run's configuration, task and data facts.

    Args:
        directory: the run's.
        store: where its stores lie, if not where the run had them.

    Returns:
        The configuration, with no more workers than this machine has cores; the task; the facts.

    Raises:
        RunError: run.json is missing or damaged, or speaks of more or fewer simulated images than the run had.
        ConfigError: its configuration is none of this version.
    """
    run = directory.read_run()
    try:
        task = run["task"]
        rebuilt = Task(
            name=task["name"],
            contract=Contract.from_json(task["contract"]),
            baseline=task["baseline"],
            system=task["system"],
            instructions=tuple(Instruction(**entry) for entry in task["instructions"]),
            crossover=task["crossover"],
        )
        config, facts = from_plain(run["config"]), DataFacts.from_json(run["data"])
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"{directory.path}/run.json is damaged: {type(error).__name__}: {error}") from error
    images = sum(facts.counts)
    if config.data.source is DataSource.simulated and config.data.images != images:
        raise RunError(
            f"{directory.path}/run.json has data.images={config.data.images}, and a data set of {images}; restore it"
        )
    root = config.store.root if store is None else store
    workers = min(config.executor.workers, os.cpu_count() or 1)
    here = replace(config.executor, workers=workers)
    return replace(config, store=StoreConfig(root=root), executor=here), rebuilt, facts


def _compare_files(directory: RunDirectory, plan: Plan, state: SearchState) -> None:
    """Hold what stands beside the ledger against the replayed search.

    Raises:
        DivergenceError: a file was edited, or is missing; the message names it.
    """
    for name, content in archive_files(plan, state).items():
        path = directory.path / name
        recorded = _read_json(path) if path.exists() else None
        if recorded != content:
            field = differences(recorded, content)[0]
            was, now = (json.dumps(value_at(value, field) if field else None) for value in (recorded, content))
            values = f": field {shown(field)!r} was recorded as {was[:200]} and is now {now[:200]}" if field else ""
            raise DivergenceError(f"{path} is missing, or is not what the search gives{values}")


def _read_json(path: Path) -> Json | None:
    """Read a JSON file; None where it is none, which equals nothing that a search gives."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return None


class _Verifier(Watcher):
    """Holds every candidate's file against what the replay gives."""

    def __init__(self, directory: RunDirectory, plan: Plan, view: View) -> None:
        super().__init__(plan, view)
        self._directory = directory
        #: What each candidate's answers cost.
        self.spending: dict[str, Spending] = {}
        #: Names of the files that were compared.
        self.files: list[str] = []

    def developed(self, outcome: Outcome) -> None:
        """Compare the source of an admitted candidate, or the answer of a rejected one.

        Raises:
            DivergenceError: the file was edited, or is missing.
        """
        name = outcome.proposal.id
        self.spending[name] = spending_on(outcome.completions)
        if outcome.admitted is not None:
            expected, ending = outcome.admitted.source, ".py"
        elif isinstance(outcome.result, Rejection) and outcome.completion is not None:
            expected, ending = rejected_text(outcome.result, outcome.completion.text), ".rejected.txt"
        else:
            return
        self.files.append(f"{name}{ending}")
        if self._directory.read_kept(name) != expected:
            folder = self._directory.path / "candidates"
            raise DivergenceError(f"the file of {name} in {folder} is missing, or is not what was judged")
