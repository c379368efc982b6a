"""A whole run: its data, its directory, its ledger and the search between them; and its replay."""

import contextlib
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.choices import Tracking
from tacevo.config.compose import to_plain
from tacevo.config.schema import RunConfig
from tacevo.config.tasks import load_task
from tacevo.costs import Spending, spending_on, total
from tacevo.data.dataset import Dataset
from tacevo.environment import checked_out, machine, versions
from tacevo.errors import DivergenceError, RunError
from tacevo.records import DataFacts, Json, Mode, Rejection, to_json
from tacevo.redaction import without_password
from tacevo.rules import CURRENT, PAGES, Era
from tacevo.runs.datasets import load_data
from tacevo.runs.header import archive_files, run_header
from tacevo.runs.progress import Progress, Watcher
from tacevo.runs.providers import build_llm
from tacevo.runs.summary import summarise
from tacevo.runs.wiring import Workbench, build_plan
from tacevo.sandbox.confinement import in_force, require
from tacevo.search.algorithm import Plan, SearchState, run_eras
from tacevo.search.development import Outcome
from tacevo.search.proposals import Task
from tacevo.storage.canonical import content_hash
from tacevo.storage.ledger import Ledger
from tacevo.storage.run_directory import SCHEMA, RunDirectory
from tacevo.storage.store import sweep_stores
from tacevo.tracking.process import Mirror
from tacevo.training.evaluation import Run
from tacevo.training.numerics import check_machine

#: Seconds that a finished search waits for the mirror; what is left, the mirror finishes on its own.
MIRROR_SECONDS = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A finished run."""

    directory: Path
    digest: str
    summary: str
    #: Id of the network archive's fittest elite.
    best: str


def search(config: RunConfig, view: Progress) -> Result:
    """Run a search, or take up the one that was begun under the same configuration.

    Raises:
        TacevoError: see its subclasses; what was computed so far is kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    require_means(config)
    data = load_data(config, view)
    return record(config, load_task(config, data.facts), data, view)


def require_means(config: RunConfig) -> None:
    """Tell what a search lacks here before anything is made.

    Raises:
        SandboxError: candidates cannot be confined as the configuration asks.
        ConfigError: the machine cannot compute as it asks, or the model cannot be reached for want of a key.
    """
    require(config.sandbox.require)
    check_machine(config.numerics.kind, config.training.device)
    build_llm(config, Mode.record)


def record(
    config: RunConfig,
    task: Task,
    data: Dataset,
    view: Progress,
    *,
    begun: Sequence[dict[str, Json]] = (),
    eras: Sequence[Era] = (Era(generation=0, rules=CURRENT),),
    run: Run | None = None,
) -> Result:
    """Run a search into its run directory, or continue the one that was begun there.

    Args:
        config: the configuration.
        task: the task.
        data: the data set.
        view: shows how far the search is.
        begun: the ledger of another run that this one continues; its lines are held against the search as those of a
            stopped run are.
        eras: the rules to search under, from which generation on.
        run: what runs candidates in place of a sandbox.

    Raises:
        TacevoError: see its subclasses; what was computed so far is kept.
    """
    plan, facts = build_plan(config, task, Mode.record), data.facts
    header = run_header(config, task, facts, plan, eras[0].rules)
    directory = RunDirectory(_run_path(config, [header, config.search.generations, *(era.line() for era in eras[1:])]))
    with directory.locked(), _opened(directory, begun) as ledger:
        _commit_header(ledger, header, directory)
        directory.sweep()
        sweep_stores(Path(config.store.root))
        _begin(directory, config, task, facts)
        view.say(f"run: {directory.path} ({_stage(ledger)})")
        with _mirrored(config, directory, view):
            observer, walls = _Recorder(directory, ledger, plan, view), Walls(directory)
            with Workbench(config, task, facts, Mode.record, data=data, notice=walls.note, run=run) as bench:
                state = run_eras(plan, eras, bench.tools, ledger, observer)
            _refuse_longer(ledger, directory)
            summary = _finish(directory, config, state, ledger.digest)
        best = max(state.networks.archive.elites.values(), key=lambda elite: elite.objective).name
        return Result(directory=directory.path, digest=ledger.digest, summary=summary, best=best)


def _opened(directory: RunDirectory, begun: Sequence[dict[str, Json]]) -> Ledger:
    """Open the ledger, which begins with the lines of the run that is continued, if one is."""
    if begun:
        directory.begin_with(begun)
    return Ledger(directory.ledger)


def _run_path(config: RunConfig, content: Json) -> Path:
    """Name the folder of a run after what decides it, so that the same command finds it again."""
    if config.run.dir is not None:
        return Path(config.run.dir)
    name = content_hash(content)[:8]
    return Path("runs") / f"{config.task.name}-seed{config.seed}-{name}"


def _begin(directory: RunDirectory, config: RunConfig, task: Task, facts: DataFacts) -> None:
    """Write run.json, unless the begun run has it already; the ledger's header has just been found to be ours."""
    described = {"task": to_json(task), "data": to_json(facts)}
    if (directory.path / "run.json").exists():
        run = directory.read_run()
        if {key: run.get(key) for key in described} == described:
            return
    directory.write_json(
        "run.json",
        {
            "schema": SCHEMA,
            "name": directory.path.name,
            "config": _publishable(config),
            **described,
            "versions": versions(),
            "machine": machine(),
            "code": checked_out(),
            "confinement": [],  # nothing has been in force for anybody yet
            "digest": None,
            "pages": PAGES,
        },
    )


def _publishable(config: RunConfig) -> dict[str, Json]:
    """Write the configuration without the passwords that an address may hold: a run directory is there to be shared."""
    plain = to_plain(config)
    plain["tracking"]["uri"] = without_password(config.tracking.uri)
    if config.llm.base_url is not None:
        plain["llm"]["base_url"] = without_password(config.llm.base_url)
    return plain


def _commit_header(ledger: Ledger, header: dict[str, Json], directory: RunDirectory) -> None:
    try:
        ledger.commit(header)
    except DivergenceError as error:
        raise RunError(
            f"run.dir={directory.path} holds another run, or one under other rules ({error}); choose another run.dir"
        ) from error


def _stage(ledger: Ledger) -> str:
    return "new" if ledger.recorded == 0 else f"taken up after {ledger.recorded} ledger lines"


def _refuse_longer(ledger: Ledger, directory: RunDirectory) -> None:
    if ledger.recorded > ledger.committed:
        raise RunError(
            f"run.dir={directory.path} holds a longer run ({ledger.recorded} ledger lines; this one has "
            f"{ledger.committed}); raise search.generations, or choose another run.dir"
        )


def _finish(directory: RunDirectory, config: RunConfig, state: SearchState, digest: str) -> str:
    """Write what is known only at the end; return the summary."""
    run = directory.read_run()
    run |= {"config": _publishable(config), "digest": digest, "pages": PAGES}
    directory.write_json("run.json", run)
    names = [elite.name for elite in state.networks.archive.elites.values()]
    summary = summarise(run, directory.read_ledger(), names, directory.read_spending())
    directory.write_text("summary.md", summary)
    return summary


@contextlib.contextmanager
def _mirrored(config: RunConfig, directory: RunDirectory, view: Progress) -> Iterator[None]:
    """Let a mirror follow the ledger, where one is wanted; it cannot stop the search."""
    if config.tracking.kind is Tracking.none:
        yield
        return
    mirror = Mirror(directory.path, uri=config.tracking.uri, experiment=config.tracking.experiment)
    mirror.start()
    finished = False
    try:
        yield
        finished = True
    finally:
        warning = mirror.finish(MIRROR_SECONDS if finished else 0.0)
        if warning is not None:
            view.say(warning)


class Walls:
    """Keeps in run.json what held the candidates of a run, each way once, in the order in which they came.

    A run may be continued where less is in force; a candidate that is recalled from the stores adds nothing.

    Args:
        directory: of the run, with its run.json.
    """

    def __init__(self, directory: RunDirectory) -> None:
        self._directory = directory
        self._lock = threading.Lock()  # candidates are waited for in several threads
        self._known: set[tuple[str, ...]] = set()

    def note(self, measures: tuple[str, ...]) -> None:
        """Keep what held one candidate, which has not been given an answer yet."""
        with self._lock:
            if measures in self._known:
                return
            run, described = self._directory.read_run(), in_force(measures)
            with self._directory.believed():
                kept = run["confinement"]
            if not isinstance(kept, list):  # earlier versions wrote what the machine had, which held nobody for certain
                kept = []
            if described not in kept:
                self._directory.write_json("run.json", {**run, "confinement": [*kept, described]})
            self._known.add(measures)


class _Recorder(Watcher):
    """Shows the search to a view and keeps its files; the ledger itself is kept by the search."""

    def __init__(self, directory: RunDirectory, ledger: Ledger, plan: Plan, view: Progress) -> None:
        super().__init__(plan, view)
        self._directory = directory
        self._ledger = ledger
        self._spent = directory.read_spending()
        #: What the candidates of the present generation cost.
        self._generation: list[Spending] = []

    def developed(self, outcome: Outcome) -> None:
        """Keep a candidate's source, or why it has none, before the ledger names it."""
        name = outcome.proposal.id
        if outcome.admitted is not None:
            self._directory.keep_candidate(name, outcome.admitted.source)
        elif isinstance(outcome.result, Rejection) and outcome.completion is not None:
            self._directory.keep_rejected(name, outcome.result, outcome.completion.text)
        spent = spending_on(outcome.completions)
        self._generation.append(spent)
        if self._spent.get(name) != spent:
            self._directory.add_timing({"id": name, "seconds": round(outcome.seconds, 3), **to_json(spent)})

    def committed(self, line: dict[str, Json], state: SearchState) -> None:
        """Show a line, and write the archives at the end of each generation that was not complete before."""
        super().committed(line, state)
        if line["kind"] != "generation":
            return
        spent, self._generation = total(self._generation), []
        if self._ledger.committed >= self._ledger.recorded:
            self._directory.add_timing({"generation": line["generation"], **to_json(spent)})
            for name, content in archive_files(self._plan, state).items():
                self._directory.write_json(name, content)
