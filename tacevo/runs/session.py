"""A whole run: its data, its directory, its ledger and the search between them."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from tacevo.config.chosen import part_of
from tacevo.config.identity import length
from tacevo.config.network_files import read_networks
from tacevo.config.schema import RunConfig, TrackingConfig
from tacevo.config.task_texts import load_task
from tacevo.costs import Spending, spending_on, total
from tacevo.data.dataset import Dataset
from tacevo.environment import checked_out, machine, versions
from tacevo.errors import ConfigError, DivergenceError, RunError, telling
from tacevo.evolution.development import LLM, Outcome
from tacevo.evolution.lines import GenerationLine, SearchLine
from tacevo.evolution.run_files import EliteEntry, Line, RunLine, line_kind, read_ledger, write_archives
from tacevo.evolution.state import Plan, SearchState
from tacevo.llm.recording import RecordingLLM
from tacevo.parts.kinds import TRACKERS
from tacevo.parts.tracker import Mirror, Tracker, Untracked
from tacevo.records import DataFacts, Json, Mode, Rejection, Task, to_json, written
from tacevo.redaction import without_password
from tacevo.results.run import RecordedRun
from tacevo.results.summary import evaluated, in_short, summarise
from tacevo.rounding import significant
from tacevo.rules import CURRENT, PAGES
from tacevo.runs.answer_counts import UsableAnswers
from tacevo.runs.data_warnings import warnings_of
from tacevo.runs.datasets import load_data, trivial_of
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.given_networks import admitted_networks
from tacevo.runs.local import crowded, trainings_at_once
from tacevo.runs.progress import FINISHED_BEFORE, Progress, Watcher
from tacevo.runs.providers import Begun, asks_elsewhere, build_llm, name_warning
from tacevo.runs.search_files import archive_files, run_header, run_under
from tacevo.runs.unsent import recalled_without
from tacevo.runs.wiring import Workbench, build_plan, check_means, skipping_of, started_ahead, stores_of
from tacevo.sandbox.client import RunJob
from tacevo.storage.canonical import content_hash
from tacevo.storage.files import write_durably
from tacevo.storage.ledger import Ledger, Sealed, sealed_text
from tacevo.storage.run_directory import RunDirectory, RunRecord
from tacevo.storage.store import remove_leftovers_in_stores
from tacevo.text import counted

#: Seconds that a finished search or study waits for the mirror; what is left, the mirror finishes on its own.
MIRROR_SECONDS = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """A finished run."""

    directory: Path
    digest: str
    #: The result in short; summary.md in the directory has all of it.
    summary: str
    #: Id of the network archive's fittest elite; the baseline's where all failed when they were trained again.
    best: str
    #: Whether it found a network that is better than the baseline and than chance.
    succeeded: bool
    #: Whether its evaluations are those of a table, which has few other seeds.
    looked_up: bool
    #: The number of answers that were asked for and paid now, and of those that came from the store
    #: (`tacevo.costs.Tally`).
    asked: str = ""


def search(config: RunConfig, view: Progress) -> Result:
    """Run a search, or resume the one that was begun under the same configuration.

    Raises:
        TacevoError: see its subclasses; what was computed so far is kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    begun = Begun()
    llm = needed_llm(config, begun)
    with started_ahead(config) as started:
        data = load_data(config, view)
        task = load_task(config, data.facts)
        if config.search.networks:
            files = read_networks(config.search.networks, "search.networks")
            task = replace(task, given=admitted_networks(config, task, data, files, "search.networks"))
        for warning in [*crowded(config), *warnings_of(config, task, data)]:
            view.say(f"warning: {warning}")
        return record(config, task, data, view, started=started, llm=llm, went=begun)


def needed_llm(config: RunConfig, begun: Begun | None = None) -> LLM:
    """Check, before anything is made, that this machine has what a search needs; return its model.

    `begun` is as of `build_llm`.

    Raises:
        SandboxError: as `check_means`.
        ConfigError: as `check_means`; the model's key is missing; or a part is.
    """
    check_needed(config)
    return build_llm(config, Mode.record, begun=begun)


def check_needed(config: RunConfig) -> None:
    """Check that this machine has what a run needs that asks no model.

    Raises:
        SandboxError: as `check_means`.
        ConfigError: as `check_means`; or a part is missing.
    """
    check_means(config)
    part_of(config, TRACKERS)
    skipping_of(config)


def record(
    config: RunConfig,
    task: Task,
    data: Dataset,
    view: Progress,
    *,
    begun: Sealed[Line] | None = None,
    run: RunJob | None = None,
    started: Any = None,
    llm: LLM | None = None,
    parts_of: Path | None = None,
    went: Begun | None = None,
) -> Result:
    """Run a search into its run directory, or resume the one that was begun there.

    `begun` is the ledger of another run that this one continues; the search is compared with its lines as with those
    of a stopped run. `run`, `started` and `llm` are as of `Workbench`. The sources of parts that a user brought are
    those of the run `parts_of`, or else those that composing read. `went` is what `llm` was built with: whether the run
    goes without its temperature is written there before the first request.

    Raises:
        TacevoError: see its subclasses; what was computed so far is kept.
    """
    with Decisions(stores_of(config).of("decisions", Mode.record)) as decisions:
        parts = Parts.of(config, decisions, parts_of)
        went = went or Begun()
        return _record(config, task, data, view, parts, begun=begun, run=run, started=started, llm=llm, went=went)


def _record(
    config: RunConfig,
    task: Task,
    data: Dataset,
    view: Progress,
    parts: Parts,
    *,
    begun: Sealed[Line] | None,
    run: RunJob | None,
    started: Any,
    llm: LLM | None,
    went: Begun,
) -> Result:
    """Run a search, as `record` does, with the parts that decide in it."""
    facts = data.facts
    plan = build_plan(config, task, facts, Mode.record, parts=parts)
    header = run_header(config, task, facts, plan, CURRENT)
    decisive: list[Json] = [written(header), *length(config).values()]
    directory = RunDirectory(_run_path(config, decisive))
    if not directory.path.exists():
        recalled_without(config, directory.path)  # what is refused leaves no directory
    with directory.locked(), _opened(directory, begun) as ledger, telling(lambda: _has_candidates(ledger)):
        if not ledger.recorded and (unsent := recalled_without(config, directory.path)):
            went.is_without = True
            view.say(unsent)
        _commit_header(ledger, header, directory)
        directory.remove_leftovers()
        remove_leftovers_in_stores(Path(config.store.root))
        trivial = trivial_of(config, task, data)
        _begin(directory, config, task, facts, trivial)
        for name, sources in parts.sources.items():
            directory.keep_part(name, sources)
        was_finished = directory.read_run().digest == ledger.recorded_digest
        view.say(f"run: {directory.path} ({_stage(ledger, was_finished=was_finished)})")
        view.say(f"candidates: {_planned(plan, task)}")
        view.say(f"trivial loss: {significant(trivial)}, that of the best constant answer")
        if warning := name_warning(config.llm):
            view.say(f"warning: {warning}")
        with mirrored(config, directory, view, has_news=lambda: ledger.has_grown or not was_finished):
            usable, confinement = UsableAnswers(config.search.stop_after_unusable), ConfinementLog(directory)
            observer = _Recorder(
                directory,
                ledger,
                plan,
                view,
                usable=usable,
                trivial=trivial,
                did=evaluated(config),
                at_once=trainings_at_once(config) if config.executor.is_here else config.executor.workers,
                saving=partial(_saved, config, len(data.train)),
                elsewhere=asks_elsewhere(config.llm),
                was_finished=was_finished,
            )
            with Workbench(
                config,
                task,
                facts,
                Mode.record,
                data=data,
                notice=confinement.note,
                say=view.say,
                run=run,
                started=started,
                llm=llm,
            ) as bench:
                state = run_under(CURRENT, plan, bench.effects, ledger, observer)
            _check_length(ledger, directory)
            if was_finished and not ledger.has_grown:
                view.say(FINISHED_BEFORE)
            elites = archive_files(plan, state)[0].elites
            summary, succeeded = _finish(directory, config, elites, ledger.digest, elsewhere=observer.elsewhere)
        best = max(state.networks.archive.elites.values(), key=lambda elite: elite.objective, default=None)
        name = next(iter(state.candidates)) if best is None else best.name
        return Result(
            directory=directory.path,
            digest=ledger.digest,
            summary=summary,
            best=name,
            succeeded=succeeded,
            looked_up=config.data.facts.is_looked_up,
            asked=llm.tally.in_words if isinstance(llm, RecordingLLM) else "",
        )


def _saved(config: RunConfig, images: int) -> float:
    """Measure what faster numerics would save, as `part_saved`, a hint that takes a room which may be missing."""
    try:
        from tacevo.runs.pace import part_saved
    except ModuleNotFoundError:
        return 0.0
    return part_saved(config, images)


def _opened(directory: RunDirectory, begun: Sealed[Line] | None) -> Ledger:
    """Open the ledger, which begins with the lines of the run that is continued, if one is.

    Raises:
        RunError: a ledger stands there that does not begin so.
    """
    if begun is not None:
        standing = read_ledger(directory)
        if not standing.lines:
            write_durably(directory.ledger, sealed_text(begun.lines)[0])
        elif standing.hashes[: len(begun.hashes)] != begun.hashes:
            raise RunError(
                "a different or shorter ledger",
                place=f"run.dir={directory.path}",
                expected="a ledger that begins with the lines of the continued run",
                remedy="choose another run.dir",
            )
    return Ledger.open(directory.ledger, line_kind)


def _run_path(config: RunConfig, content: Json) -> Path:
    """Name the directory of a run after what decides it, so that the same command finds it again."""
    if config.run.dir is not None:
        return Path(config.run.dir)
    name = content_hash(content)[:8]
    return Path("runs") / f"{config.task.name}-seed{config.seed}-{name}"


def _begin(directory: RunDirectory, config: RunConfig, task: Task, facts: DataFacts, trivial: float) -> None:
    """Write run.json, unless the begun run has it already; the ledger's header has just been found to be ours."""
    if (directory.path / "run.json").exists():
        run = directory.read_run()
        if (run.task, run.data) == (task, facts):
            return
    directory.write_run(
        RunRecord(
            name=directory.path.name,
            config=_publishable(config),
            task=task,
            data=facts,
            versions=versions(),
            machine=machine(),
            code=checked_out(),
            confinement=(),  # no candidate has run yet
            digest=None,
            pages=PAGES,
            trivial=trivial,
            elsewhere=asks_elsewhere(config.llm),
        )
    )


def _publishable(config: RunConfig) -> dict[str, Json]:
    """Return the configuration without passwords and addresses, because run directories are shared."""
    base_url = None if config.llm.base_url is None else without_password(config.llm.base_url)
    executor = replace(config.executor, address=None)
    return to_json(replace(config, llm=replace(config.llm, base_url=base_url), executor=executor))


def _commit_header(ledger: Ledger, header: RunLine, directory: RunDirectory) -> None:
    try:
        ledger.commit(header)
    except DivergenceError as error:
        raise RunError(
            f"another run: in {error.place}, it has {error.expected}, and this one has {error.got}",
            place=f"run.dir={directory.path}",
            expected="no run, or this one",
            remedy="choose another run.dir, or remove that directory",
        ) from error


def _has_candidates(ledger: Ledger) -> bool:
    """Return whether a candidate has its line, now or from before; the first line is the header."""
    return max(ledger.committed, ledger.recorded) > 1


def _planned(plan: Plan, task: Task) -> str:
    """Say what a search trains, in order."""
    most = ", at most" if plan.budget else ""
    others = (
        f"{counted(plan.initial, 'network')} of yours" if task.given else f"{counted(plan.initial, 'mutation')} of it"
    )
    first = f"first the baseline, then {others}"
    return f"{first}, then {counted(plan.generations, 'generation')} of {plan.settings.candidates}{most}"


def _stage(ledger: Ledger, *, was_finished: bool) -> str:
    if ledger.recorded == 0:
        return "new"
    return f"{'finished' if was_finished else 'resumed'} after {ledger.recorded} ledger lines"


def _check_length(ledger: Ledger, directory: RunDirectory) -> None:
    if ledger.recorded > ledger.committed:
        raise RunError(
            f"a longer run of {ledger.recorded} ledger lines",
            place=f"run.dir={directory.path}",
            expected=f"at most the {ledger.committed} ledger lines of this run",
            remedy="raise search.generations or search.training_flops, or choose another run.dir",
        )


def _finish(
    directory: RunDirectory, config: RunConfig, elites: tuple[EliteEntry, ...], digest: str, *, elsewhere: bool
) -> tuple[str, bool]:
    """Write what is known only at the end; return the summary in short, and whether the search found something."""
    began = directory.read_run()
    record = replace(began, config=_publishable(config), digest=digest, pages=PAGES, elsewhere=elsewhere)
    directory.write_run(record)
    ledger = read_ledger(directory)
    run = RecordedRun(directory=directory, record=record, config=config, ledger=ledger, elites=elites)
    directory.write_text("summary.md", summarise(run))
    return in_short(run), not run.shortfall


@contextlib.contextmanager
def mirrored(
    config: RunConfig, directory: RunDirectory, view: Progress, has_news: Callable[[], bool] = lambda: True
) -> Iterator[None]:
    """Let a mirror follow a run, where one is wanted; it cannot stop what is done meanwhile.

    Without news, where all was finished before, nobody waits for it: what it lacks it writes by itself.
    """
    mirror = _tracker_of(config, view).mirror([directory.path])
    finished = False
    try:
        yield
        finished = True
    finally:
        if mirror is not None and finished and not has_news():
            mirror.finish(0.0)
        else:
            _wait_for([(mirror, config)] if mirror else [], view, finished=finished)


def _tracker_of(config: RunConfig, view: Progress) -> Tracker:
    """Return what mirrors a run; where that is not installed, a recorded run is studied without."""
    try:
        tracker: Tracker = part_of(config, TRACKERS)
    except ConfigError as error:
        view.say(f"warning: nothing is mirrored: {error}")
        return Untracked()
    return tracker


@contextlib.contextmanager
def mirrored_together(view: Progress) -> Iterator[list[tuple[RunConfig, RunDirectory]]]:
    """Mirror finished runs once a block of work is done, one after the other, and wait for that once.

    Yields:
        A list, to which the block adds each run, with the configuration that says where it is mirrored.
    """
    runs: list[tuple[RunConfig, RunDirectory]] = []
    finished = False
    try:
        yield runs
        finished = True
    finally:
        places: dict[Tracker, list[tuple[RunConfig, RunDirectory]]] = {}
        for config, directory in runs:
            places.setdefault(_tracker_of(config, view), []).append((config, directory))
        mirrors = [
            (mirror, together[0][0])
            for tracker, together in places.items()
            if (mirror := tracker.mirror([directory.path for _, directory in together]))
        ]
        _wait_for(mirrors, view, finished=finished)


def _wait_for(mirrors: Sequence[tuple[Mirror, RunConfig]], view: Progress, *, finished: bool) -> None:
    """End mirrors, each of runs of one configuration; wait for those that were asked for, where all work is finished.

    Nobody asked for the one that a run has by default: it goes on by itself.
    """
    asked = [config.tracking != TrackingConfig() for _, config in mirrors]
    if finished and any(asked):
        view.say(f"mirror: waiting for its last lines, {MIRROR_SECONDS:.0f} s at most")
    deadline = time.monotonic() + (MIRROR_SECONDS if finished else 0.0)
    for (mirror, _), is_asked in zip(mirrors, asked, strict=True):
        warning = mirror.finish(max(0.0, deadline - time.monotonic()) if is_asked else 0.0)
        if warning is not None:
            view.say(warning)


class ConfinementLog:
    """Keeps in run.json what confined the candidates of a run, each way once, in the order in which they came.

    A run may be continued where less is in force; a candidate that is recalled from the stores adds nothing.
    """

    def __init__(self, directory: RunDirectory) -> None:
        self._directory = directory
        self._lock = threading.Lock()  # candidates are waited for in several threads
        self._known: list[Mapping[str, str]] = []

    def note(self, measures: Mapping[str, str]) -> None:
        """Keep what confined one candidate, before its answer is used."""
        with self._lock:
            if measures in self._known:
                return
            run = self._directory.read_run()
            if measures not in run.confinement:
                self._directory.write_run(replace(run, confinement=(*run.confinement, dict(measures))))
            self._known.append(measures)


class _Recorder(Watcher):
    """Shows the search to a view and keeps its files; the ledger itself is kept by the search."""

    def __init__(
        self,
        directory: RunDirectory,
        ledger: Ledger,
        plan: Plan,
        view: Progress,
        *,
        usable: UsableAnswers,
        trivial: float,
        did: str,
        at_once: int,
        saving: Callable[[], float],
        elsewhere: bool,
        was_finished: bool,
    ) -> None:
        super().__init__(plan, view, trivial, did=did, at_once=at_once, saving=saving)
        #: Whether what stood here before was a finished run, of which nothing is told again.
        self._was_finished = was_finished
        self._usable = usable
        self._directory = directory
        self._ledger = ledger
        self._spent = directory.read_spending()
        #: The costs of the present generation's candidates.
        self._generation: list[Spending] = []
        #: Whether another server than the provider's own is asked, or gave a recorded answer.
        self.elsewhere = elsewhere

    def developed(self, outcome: Outcome) -> None:
        """Keep a candidate's source, or why it has none, before the ledger names it."""
        super().developed(outcome)
        self._usable.take(outcome)
        name = outcome.proposal.id
        self.elsewhere |= any(completion.elsewhere for completion in outcome.completions)
        if outcome.admitted is not None:
            self._directory.keep_candidate(name, outcome.admitted.source)
        elif isinstance(outcome.result, Rejection) and outcome.completion is not None:
            self._directory.keep_rejected(name, outcome.result, outcome.completion.text)
        spent = spending_on(outcome.completions)
        self._generation.append(spent)
        if self._spent.get(name) != spent:
            seconds, cpu = round(outcome.seconds, 3), round(outcome.cpu_seconds, 2)
            self._directory.add_timing(spent, id=name, seconds=seconds, cpu_seconds=cpu or None)

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Show a line, and write the archives at the end of each generation that was not complete before.

        Raises:
            LLMError: too many generations in a row brought no usable answer; what they are is kept.
        """
        super().committed(line, state)
        if not isinstance(line, GenerationLine):
            return
        spent, self._generation = total(self._generation), []
        if self._ledger.committed >= self._ledger.recorded:
            self._directory.add_timing(spent, generation=line.generation)
            write_archives(self._directory, archive_files(self._plan, state))
        warning = self._usable.close(line.generation)
        if warning is not None and (self._ledger.has_grown or not self._was_finished):
            self._view.say(warning)
        # Lines that stood here before do not stop a search: whoever repeats the command wants it to go on.
        if self._ledger.has_grown and not state.is_past(self._plan):
            self._usable.check()

    def tell(self, line: GenerationLine, reached: str) -> None:
        """Write the line of a generation; one that stood here before was not trained now, and says so."""
        if self._ledger.has_grown:
            super().tell(line, reached)
        elif not self._was_finished:
            self.say(f"generation {line.generation} as recorded: {reached}")
