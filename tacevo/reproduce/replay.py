"""Replay: a recorded search run again from its stores alone, and held against every line and file of it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tacevo.config.recorded import doubting, read_run
from tacevo.costs import Spending, spending_on, total
from tacevo.environment import deviations, versions
from tacevo.errors import DivergenceError
from tacevo.records import Json, Mode, Rejection
from tacevo.rules import CORES, check_known, eras_of
from tacevo.runs.header import archive_files, run_header
from tacevo.runs.progress import Progress, Watcher
from tacevo.runs.wiring import Workbench, build_plan
from tacevo.search.algorithm import Plan, SearchState, run_eras
from tacevo.search.development import Outcome
from tacevo.storage.canonical import differences, shown, value_at
from tacevo.storage.ledger import Ledger
from tacevo.storage.run_directory import RunDirectory, rejected_text
from tacevo.storage.store import Seen


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


def replay(path: Path, store: str | None, view: Progress, *, seen: Seen | None = None) -> Replayed:
    """Run a recorded search again from its stores alone, and compare every line and file of it.

    Neither the data set nor a model nor a sandbox is used. Verdicts, profiles and trainings are recalled under the
    rules that the run recorded, whatever those of this release are.

    Args:
        path: the run directory.
        store: where the stores lie, if not where the run had them.
        view: who is told.
        seen: told of every store entry that the replay reads, from any thread.

    Raises:
        DivergenceError: something recorded differs from what the search gives.
        CacheMissError: a store lacks an answer.
        RunError: this is no run directory, its ledger is damaged, or this release cannot compute its core rules.
    """
    directory = RunDirectory(path)
    with directory.believed():
        others = deviations(directory.read_run()["versions"], versions())
    for other in others:
        view.say(f"another version: {other}")
    with doubting(others):
        return _replay(directory, store, view, seen)


def _replay(directory: RunDirectory, store: str | None, view: Progress, seen: Seen | None) -> Replayed:
    """Run the search again, and compare."""
    config, task, facts = read_run(directory, store)
    recorded = directory.read_finished()
    with directory.believed():
        eras = eras_of(recorded)
    for era in eras:
        check_known("core", era.rules.core, CORES, directory.path)
    plan = build_plan(config, task, Mode.replay, seen=seen)

    with Workbench(config, task, facts, Mode.replay, seen=seen) as bench, Ledger(None, recorded) as ledger:
        ledger.commit(run_header(config, task, facts, plan, eras[0].rules))
        verifier = _Verifier(directory, plan, view)
        state = run_eras(plan, eras, bench.tools, ledger, verifier)
        if ledger.committed != len(recorded):
            raise DivergenceError(f"the ledger has {len(recorded)} lines; the search gives {ledger.committed}")
        _compare_files(directory, plan, state)
        return Replayed(
            digest=ledger.digest,
            lines=ledger.committed,
            spending=verifier.spending,
            files=frozenset(verifier.files),
        )


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

    def __init__(self, directory: RunDirectory, plan: Plan, view: Progress) -> None:
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
