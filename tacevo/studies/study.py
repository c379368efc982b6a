"""`tacevo study`: the baseline and the best elites of a run, trained fully with several seeds and tested.

Every training is in the store as soon as it ends, so a study that was stopped goes on where it was, and several
processes with one store may work on the same one. The order of the work enters no file.
"""

import random
from collections.abc import Callable, Sequence, Set
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from tacevo.config.recorded import doubting, read_run
from tacevo.config.schema import RunConfig
from tacevo.config.study import StudyConfig
from tacevo.data.labels import units_of
from tacevo.environment import deviations, machine, versions
from tacevo.errors import DivergenceError, RunError
from tacevo.randomness import derived_seed
from tacevo.records import DataFacts, Json, Kind, Limits, Mode, Recipe, Rejection
from tacevo.rules import STUDY
from tacevo.runs.datasets import load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import Workbench, recipe_of
from tacevo.sandbox.confinement import require
from tacevo.search.proposals import Task
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Seen, sweep_stores
from tacevo.storage.study_directory import StudyDirectory, describes, name_study, studies_of
from tacevo.studies.networks import networks_of, score_line, study_header, study_rules
from tacevo.studies.terms import Margin, Terms, fewest_seeds
from tacevo.text import counted
from tacevo.training.full import FullEvaluator, FullTraining
from tacevo.training.numerics import check_machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Studied:
    """A finished study."""

    directory: Path
    digest: str
    #: Trainings of all networks and seeds.
    trainings: int
    #: Those that were in the store before.
    recorded: int
    #: Those that came to no end, as `variant 2, seed 3: out_of_time`.
    failed: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Job:
    """One network to be trained with one seed."""

    network: dict[str, Json]
    #: 0 to S - 1.
    index: int
    source: str
    #: Of the training; equal for all networks, so that they are paired by seed.
    seed: int

    @property
    def row(self) -> str:
        """Name the row of the scores."""
        return f"{self.network['name']}, seed {self.index}"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """All that a study follows from."""

    #: Of the run, with the training of the study.
    config: RunConfig
    task: Task
    facts: DataFacts
    header: dict[str, Json]
    #: In the order of the scores.
    jobs: tuple[_Job, ...]


def study(config: StudyConfig, view: Progress) -> Studied:
    """Study a finished run, or take up a study that was begun under the same configuration.

    Raises:
        TacevoError: see its subclasses; the trainings that ended are kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    path, limits = Path(config.run or ""), Limits(seconds=config.seconds, memory_mib=config.memory_mib)
    plan = _plan(
        path,
        config.store.root,
        elites=config.elites,
        seeds=config.seeds,
        epochs=config.epochs,
        limits=limits,
        terms=partial(_stated, config),
        rules=STUDY,
    )
    run = replace(plan.config, executor=config.executor)
    require(run.sandbox.require)
    check_machine(run.numerics.kind, run.training.device)
    catalogue = source_of(run).catalogue()
    data = load_same(run, plan.facts, view, catalogue=catalogue)
    sweep_stores(Path(run.store.root))
    directory = _directory(path, plan)
    units = list(units_of(catalogue)) if data.scale else []
    circumstances = {"scale": list(data.scale), "units": units, "versions": versions(), "machine": machine()}
    directory.begin(_described(plan), circumstances)
    with Workbench(run, plan.task, plan.facts, Mode.record, data=data) as bench:
        evaluator = bench.studies(STUDY)
        recorded = {job.row for job in plan.jobs if evaluator.is_recorded(job.source, job.seed)}
        _introduce(directory, plan, config, len(recorded), view)
        verdicts = _train(plan.jobs, recorded, evaluator, bench.executor, view)
        digest = directory.finish(_entries(plan, evaluator, verdicts))
    rows = zip(plan.jobs, verdicts, strict=True)
    failed = tuple(f"{job.row}: {verdict.reason}" for job, verdict in rows if isinstance(verdict, Rejection))
    return Studied(
        directory=directory.path, digest=digest, trainings=len(plan.jobs), recorded=len(recorded), failed=failed
    )


def replay_studies(path: Path, store: str | None, view: Progress, *, seen: Seen | None = None) -> dict[str, str]:
    """Compute the scores of a run's finished studies again from the store alone, and compare every line.

    Args:
        path: the run directory.
        store: where the stores lie, if not where the run had them.
        view: who is told of a study that is passed over: it is not finished, or the run has been extended since.
        seen: told of every store entry that is read.

    Returns:
        The digest of each study, by its name.

    Raises:
        DivergenceError: a score differs, or the study is not about the networks that the run found.
        CacheMissError: the store lacks a training.
        RunError: a file is damaged.
    """
    digests = {}
    before = {line["hash"] for line in RunDirectory(path).read_finished()[:-1]}
    for directory in studies_of(path):
        name, recorded = directory.path.name, directory.read()
        if recorded.get("digest") is None:
            view.say(f"study {name} is not finished and is passed over")
        elif recorded.get("run") in before:
            view.say(f"study {name} is about the run before it was extended, and is passed over")
        else:
            with doubting(_others(directory, recorded)):
                digests[name] = _replay(path, store, directory, recorded, seen)
    return digests


def _others(directory: StudyDirectory, recorded: dict[str, Json]) -> tuple[str, ...]:
    """Say which versions are others here than those that a study was made with."""
    try:
        return deviations(recorded["versions"], versions())
    except (KeyError, AttributeError) as error:
        raise RunError(f"{directory.path}/study.json is damaged: {type(error).__name__}: {error}") from error


def _replay(
    path: Path, store: str | None, directory: StudyDirectory, recorded: dict[str, Json], seen: Seen | None
) -> str:
    """Compute the scores of one study again and compare; return the digest."""
    try:
        recipe = Recipe.from_json(recorded["recipe"])
        elites, seeds = len(recorded["networks"]) - 1, int(recorded["seeds"])
        terms = Terms.from_json(recorded["terms"])
        rules = study_rules(recorded)
    except (KeyError, TypeError, ValueError) as error:
        raise RunError(f"{directory.path}/study.json is damaged: {type(error).__name__}: {error}") from error
    plan = _plan(
        path,
        store,
        elites=elites,
        seeds=seeds,
        epochs=recipe.epochs,
        limits=recipe.limits,
        terms=lambda _: terms,
        rules=rules,
    )
    if not describes(recorded, _described(plan)):
        raise DivergenceError(f"{directory.path}/study.json was edited, or tells of another run or other networks")
    with Workbench(plan.config, plan.task, plan.facts, Mode.replay, seen=seen) as bench:
        evaluator = bench.studies(rules)
        verdicts = [evaluator.evaluate(job.source, job.seed) for job in plan.jobs]
        digest = directory.compare(_entries(plan, evaluator, verdicts))
    if digest != recorded["digest"]:
        raise DivergenceError(f"{directory.path}/study.json has the digest {recorded['digest']}; it is {digest}")
    return digest


def _stated(config: StudyConfig, kind: Kind) -> Terms:
    """Give the terms that a configuration states for a kind of task."""
    chosen = config.margins.regression if kind is Kind.regression else config.margins.classification
    return Terms(alpha=config.alpha, margin=Margin(value=chosen.value, kind=chosen.kind))


def _plan(
    path: Path,
    store: str | None,
    *,
    elites: int,
    seeds: int,
    epochs: int,
    limits: Limits,
    terms: Callable[[Kind], Terms],
    rules: int,
) -> _Plan:
    """Work out which networks of a finished run are to be trained, how, and on which terms they are judged."""
    directory = RunDirectory(path)
    config, task, facts = read_run(directory, store)
    ledger = directory.read_finished()
    training = replace(config.training, epochs=epochs, seconds=limits.seconds, memory_mib=limits.memory_mib)
    config = replace(config, training=training)
    with directory.believed():
        archive, _ = directory.read_archives(ledger)
        networks = networks_of(ledger, [entry["id"] for entry in archive["elites"]], elites)
        header = study_header(
            run=ledger[-1]["hash"],
            config=directory.read_run()["config"],
            facts=facts,
            recipe=recipe_of(config),
            seeds=seeds,
            terms=terms(facts.kind),
            networks=networks,
            rules=rules,
        )
    jobs = [
        _Job(network=network, index=index, source=source, seed=derived_seed(config.seed, "study", index))
        for network in networks
        for source in [directory.read_source(network["id"], network["source"])]
        for index in range(seeds)
    ]
    return _Plan(config=config, task=task, facts=facts, header=header, jobs=tuple(jobs))


def _directory(run: Path, plan: _Plan) -> StudyDirectory:
    """Give the folder of a study; the same command finds it again."""
    return StudyDirectory(run / "studies" / name_study(plan.header, epochs=plan.config.training.epochs))


def _described(plan: _Plan) -> dict[str, Json]:
    """Give what study.json says of what decides the scores."""
    return {key: value for key, value in plan.header.items() if key not in {"kind", "schema"}}


def _introduce(directory: StudyDirectory, plan: _Plan, config: StudyConfig, recorded: int, view: Progress) -> None:
    """Say what is studied, how much of it is done, and whether anything can come of it."""
    view.say(f"study: {directory.path} ({recorded} of {counted(len(plan.jobs), 'training')} recorded already)")
    networks = plan.header["networks"]
    view.say(", ".join(f"{network['name']}: {network['id']}" for network in networks))
    if len(networks) <= config.elites:
        view.say(f"the archive has fewer elites with a source of their own than elites={config.elites}")
    needed = fewest_seeds(config.alpha)
    if config.seeds < needed:
        view.say(
            f"no comparison will be possible: at alpha {config.alpha} no outcome of seeds={config.seeds} is "
            f"significant; it takes seeds={needed} or more"
        )


def _train(
    jobs: Sequence[_Job], recorded: Set[str], evaluator: FullEvaluator, executor: Executor, view: Progress
) -> list[FullTraining | Rejection]:
    """Train all that is not recorded, in parallel; give the verdicts in the order of the jobs.

    The view is told of those alone that were not recorded before, by their rows.
    """
    order = list(range(len(jobs)))
    # Every process takes its own order, so that two on one study rarely train the same network with the same seed.
    random.SystemRandom().shuffle(order)
    futures = {executor.submit(evaluator.evaluate, jobs[place].source, jobs[place].seed): place for place in order}
    verdicts: dict[int, FullTraining | Rejection] = {}
    done = len(recorded)
    for future in as_completed(futures):
        place = futures[future]
        verdict = verdicts[place] = future.result()
        if isinstance(verdict, Rejection):
            view.say(f"{jobs[place].row}: {verdict.reason}: {verdict.detail}")
        if jobs[place].row not in recorded:
            done += 1
            view.advance("trainings", done, len(jobs))
            if 10 * done // len(jobs) > 10 * (done - 1) // len(jobs):
                view.say(f"{done} of {len(jobs)} trainings are done")
    return [verdicts[place] for place in range(len(jobs))]


def _entries(
    plan: _Plan, evaluator: FullEvaluator, verdicts: Sequence[FullTraining | Rejection]
) -> list[dict[str, Json]]:
    """Write the lines of the scores."""
    pairs = zip(plan.jobs, verdicts, strict=True)
    return [
        plan.header,
        *(score_line(job.network, job.index, evaluator.key(job.source, job.seed), verdict) for job, verdict in pairs),
    ]
