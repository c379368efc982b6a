"""Replay: a recorded search run again from its stores alone, and compared with every line and file of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tacevo.costs import Spending, spending_on, total
from tacevo.environment import deviations, doubting, versions
from tacevo.errors import DivergenceError
from tacevo.evolution.development import Outcome
from tacevo.evolution.run_files import NETWORKS, PROMPTS, NetworkArchiveFile
from tacevo.evolution.state import Plan, SearchState
from tacevo.records import Mode, Rejection
from tacevo.results.run import RecordedRun
from tacevo.rules import CORES, check_known
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.progress import Progress, Watcher
from tacevo.runs.search_files import archive_files, run_header, run_under
from tacevo.runs.wiring import Workbench, build_plan
from tacevo.storage.ledger import Ledger, first_difference
from tacevo.storage.run_directory import RunDirectory, rejected_text
from tacevo.storage.store import Seen, Stores


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """A run that was found to be as recorded."""

    digest: str
    #: Ledger lines that were compared.
    lines: int
    #: The cost of each candidate's answers when they were recorded; the replay itself makes no call.
    spending: Mapping[str, Spending]
    #: Names of the candidates' files that were compared.
    files: frozenset[str]
    #: The number of decisions of each part that a user brought, by the setting that chose it; and whether they were
    #: made again, and not only recalled.
    decisions: Mapping[str, int] = field(default_factory=dict)
    trusted: bool = False

    @property
    def spent(self) -> Spending:
        """The cost of all of them."""
        return total(self.spending.values())


def replay(run: RecordedRun, view: Progress, *, seen: Seen | None = None, trusts: bool = False) -> Replayed:
    """Run a recorded search again from its stores alone, and compare every line and file of it.

    Neither the data set nor a model nor a sandbox is used. Verdicts, profiles and trainings are recalled under the
    rules that the run recorded, which may be others than this release's.

    `seen` is called with the name of every store entry that is read, from any thread. With `trusts`, the parts that a
    user brought decide again, by their recorded sources in confined processes, and their decisions are compared.

    Raises:
        DivergenceError: something recorded differs from what the search gives.
        CacheMissError: a store lacks an answer.
        RunError: this release cannot compute the run's core rules.
    """
    others = deviations(run.record.versions, versions())
    for other in others:
        view.say(f"another version: {other}")
    with doubting(run.record.versions):
        stores = Stores(run.stores, seen)
        with Decisions(stores.of("decisions", Mode.replay), trusts=trusts) as decisions:
            return _replay(run, view, stores, decisions)


def _replay(run: RecordedRun, view: Progress, stores: Stores, decisions: Decisions) -> Replayed:
    """Run the search again, and compare."""
    config, task, facts = run.config, run.record.task, run.record.data
    check_known("core", run.rules.core, CORES, run.directory.path)
    parts = Parts.of(config, decisions, run.directory.path)
    plan = build_plan(config, task, facts, Mode.replay, stores=stores, parts=parts)

    ledger = Ledger(run.ledger)
    ledger.commit(run_header(config, task, facts, plan, run.rules))
    verifier = _Verifier(run.directory, plan, view, run.record.trivial)
    with Workbench(config, task, facts, Mode.replay, stores=stores) as bench:
        state = run_under(run.rules, plan, bench.effects, ledger, verifier)
    if ledger.committed != ledger.recorded:
        raise DivergenceError(
            f"{ledger.recorded} lines", place=str(run.directory.ledger), expected=f"{ledger.committed} lines"
        )
    _compare_archives(run, plan, state)
    return Replayed(
        digest=ledger.digest,
        lines=ledger.committed,
        spending=verifier.spending,
        files=frozenset(verifier.files),
        decisions=decisions.counts,
        trusted=decisions.trusts,
    )


def _compare_archives(run: RecordedRun, plan: Plan, state: SearchState) -> None:
    """Compare archive.json and prompts.json with the replayed search."""
    for recorded, computed in zip(run.archives or (), archive_files(plan, state), strict=True):
        if recorded != computed:
            field, (was, now) = first_difference(recorded, computed)
            name = NETWORKS if isinstance(recorded, NetworkArchiveFile) else PROMPTS
            raise DivergenceError(was, place=f"{run.directory.path / name}, {field}", expected=now)


class _Verifier(Watcher):
    """Compares every candidate's file with the replay."""

    def __init__(self, directory: RunDirectory, plan: Plan, view: Progress, trivial: float | None) -> None:
        super().__init__(plan, view, trivial, is_replay=True)
        self._directory = directory
        #: The cost of each candidate's answers.
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
        kept = self._directory.read_kept(name)
        if kept != expected.encode():
            raise DivergenceError(
                "no file" if kept is None else "another text: it was edited",
                place=f"{self._directory.path}/candidates/{name}{ending}",
                expected="the text that was judged",
            )
