"""`tacevo study`: the baseline and other networks of a run, trained with several seeds.

A study trains them fully and tests them. Two other kinds are recorded and replayed as a study is, and see no test
image: a noise run (`tacevo.studies.noise`) trains networks as the search did, which gives their fitness under other
seeds; a choice trains elites as long as the study that follows, and its lowest validation loss chooses which one that
study is about. Each kind has seeds of its own, so what was chosen is tested by fresh draws. Every training is in the
store as soon as it ends, so a study that was stopped goes on where it was, and several processes with one store may
work on the same one. The order of the work enters no file.
"""

import contextlib
import random
from collections.abc import Sequence, Set
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path

from tacevo.choices import ChosenBy
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.config.sources import is_of_data
from tacevo.config.study import StudyConfig
from tacevo.data.dataset import Dataset
from tacevo.data.labels import units_of
from tacevo.environment import doubting, machine, versions
from tacevo.errors import DivergenceError, RunError, telling
from tacevo.evolution.fitness import Lowest
from tacevo.parts import Fitness
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.records import DataFacts, Kind, Mode, Rejection, Training
from tacevo.results.grouped import FEWEST, check_groups, images_tested
from tacevo.results.looked_up import with_table
from tacevo.results.publishable import other_device, other_settings
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study_directory import (
    FinishedStudy,
    StudyDirectory,
    chooser_of,
    estimates_of,
    find_study,
    medians_of,
    misfits,
    studies_of,
)
from tacevo.results.study_lines import (
    SCHEMA,
    FailedLine,
    Row,
    ScoreLine,
    StudyHeader,
    StudyNetwork,
    StudyRecord,
    StudyTerms,
    fewest_seeds,
)
from tacevo.rules import CURRENT, EAGER, STUDY, TRAININGS_OF_STUDIES
from tacevo.runs.datasets import load_data, load_same, source_of
from tacevo.runs.local import crowded
from tacevo.runs.progress import FINISHED_BEFORE, Progress
from tacevo.runs.seeds import choice_seed, noise_seed, study_seed
from tacevo.runs.session import mirrored
from tacevo.runs.wiring import Workbench, check_means, recipe_under, trained_by
from tacevo.storage.files import in_use
from tacevo.storage.plan_file import SeedPlan, read_plan
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Seen, Stores, remove_leftovers_in_stores
from tacevo.studies.networks import given_networks, networks_of
from tacevo.text import counted, listed
from tacevo.training.evaluation import Evaluator
from tacevo.training.full import FullEvaluator, FullTraining

#: Runs that are mirrored once other work is done, with the configuration that says where.
MirrorLater = list[tuple[RunConfig, RunDirectory]]

_Verdict = FullTraining | Training | Rejection


@dataclass(frozen=True, slots=True, kw_only=True)
class Studied:
    """A finished study."""

    directory: Path
    digest: str
    #: Trainings of all networks and seeds.
    trainings: int
    #: The number of trainings that were in the store before.
    recorded: int
    #: The number of trainings that were made now and took two, because the network learns outside its weights.
    twice: int
    #: The trainings that came to no end, as `variant 2, seed 3: out_of_time`.
    failed: tuple[str, ...]
    #: The trainings that chose the elite, where one was chosen so.
    choice: "Studied | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _NetworkTraining:
    """One network to be trained with one seed."""

    network: StudyNetwork
    #: 0 to S - 1.
    index: int
    source: str
    #: The seed of the training; equal for all networks, so that they are paired by seed.
    seed: int

    @property
    def row(self) -> str:
        """Name the row of the scores."""
        return f"{self.network.name}, seed {self.index}"


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyJob:
    """All that a study follows from."""

    run: RecordedRun
    #: The configuration of the run, with the training of the study.
    config: RunConfig
    header: StudyHeader
    #: The trainings, in the order of the scores.
    trainings: tuple[_NetworkTraining, ...]


def study(
    config: StudyConfig, view: Progress, other: Sequence[str] = (), mirror_later: MirrorLater | None = None
) -> Studied:
    """Study a finished run, or resume a study that was begun under the same configuration, which names the run.

    `other` are settings of data, numerics and device that are not the run's, such as `data.split_seed=7`. A run is
    added to `mirror_later` in place of being mirrored and waited for, where that is given (`mirrored_together`).

    Raises:
        TacevoError: see its subclasses; the trainings that ended are kept.
        KeyboardInterrupt: the user stopped it; the same command continues.
    """
    run, trained, other_data = _asked(config, other)
    if config.choose is not ChosenBy.validated or run.record.is_of_given:
        job = _tested_job(config, run, trained, chosen_by=_noise_digest(config, run))
        return train_and_record(job, config.elites if run.answered else 0, view, other_data, mirror_later)
    check_study(
        config, other
    )  # before the trainings that choose; the run is mirrored by the study, once both are there
    choice = train_and_record(_choice_job(config, run, trained), config.elites, view, mirror_later=[])
    job = _tested_job(config, run, trained, chosen_by=choice.digest, validated=config.elites)
    return replace(train_and_record(job, 1, view, other_data, mirror_later), choice=choice)


def check_study(config: StudyConfig, other: Sequence[str] = ()) -> None:
    """Check, as far as its run says, that `study` would not refuse this; nothing is written or trained.

    Raises:
        RunError: the run is not finished, or something of it was damaged or edited, or it lacks what is chosen by.
        ConfigError: its data are no images, or this machine cannot train as is asked.
        SandboxError: candidates cannot be confined as the run asks.
    """
    run, trained, other_data = _asked(config, other)
    there = replace(trained, data=other_data or trained.data)
    source = source_of(there)
    check_means(there)
    if config.choose is ChosenBy.validated:
        _choice_job(config, run, trained)
        _planned(config, run)
        source.catalogue()
    else:
        _tested_job(config, run, trained, chosen_by=_noise_digest(config, run))


def run_to_train(path: str | None, store: str | None) -> RecordedRun:
    """Read the run that is to be trained from; `store` is where its stores lie, if a user says it.

    Raises:
        RunError: its stores are not found, and none are named: trainings would be written into a stranger's.
    """
    run = read_run(Path(path or ""), store)
    if store is None:
        run.check_stores("store.root=DIR")
    return run


def _asked(config: StudyConfig, other: Sequence[str]) -> tuple[RecordedRun, RunConfig, DataConfig | None]:
    """Return the run of a study, its configuration with the study's training, and the data where they are not its."""
    run = run_to_train(config.run, config.store.root)
    elsewhere = replace(run.with_data, executor=config.executor)
    if other:
        from tacevo.config.compose import compose_elsewhere  # imports Hydra, which a replay does not need

        elsewhere = compose_elsewhere(elsewhere, other)
    training = replace(elsewhere.training, epochs=config.epochs, seconds=config.seconds, memory_mib=config.memory_mib)
    trained = replace(elsewhere, training=training, data=run.config.data)
    return run, trained, elsewhere.data if any(map(is_of_data, other)) else None


def _tested_job(
    config: StudyConfig, run: RecordedRun, trained: RunConfig, *, chosen_by: str, validated: int = 0
) -> StudyJob:
    """Work out what a study follows from that tests the best elites, or the one that was chosen among so many."""
    margins, is_regression = config.margins, run.record.data.kind is Kind.regression
    return study_job(
        run,
        trained,
        elites=config.elites,
        seeds=config.seeds,
        terms=StudyTerms(alpha=config.alpha, margin=margins.regression if is_regression else margins.classification),
        chosen_by=chosen_by,
        validated=validated,
        planned=_planned(config, run),
        rules=STUDY,
    )


def _planned(config: StudyConfig, run: RecordedRun) -> SeedPlan | None:
    return read_plan(Path(config.plan), "study", run.config.task.name) if config.plan else None


def _choice_job(config: StudyConfig, run: RecordedRun, trained: RunConfig) -> StudyJob:
    """Work out what a choice among the best elites follows from; it is made on the run's data."""
    return study_job(
        run,
        trained,
        elites=config.elites,
        seeds=1,
        terms=None,
        chosen_by="",
        validated=config.elites,
        planned=None,
        rules=CURRENT.training,
    )


def _noise_digest(config: StudyConfig, run: RecordedRun) -> str:
    """Return the digest of the noise run that elites are chosen by; empty where none is."""
    if config.choose is not ChosenBy.reestimated or run.record.is_of_given:
        return ""
    from tacevo.results.noise_runs import noise_digest  # a room of its own, which may be missing

    return noise_digest(run)


def train_and_record(
    job: StudyJob,
    elites: int,
    view: Progress,
    elsewhere: DataConfig | None = None,
    mirror_later: MirrorLater | None = None,
) -> Studied:
    """Train all that a job asks for, and write it down; `elites` were asked for, and perhaps other data."""
    if job.run.stores_found:
        view.say(job.run.stores_found)
    here = with_table(job.run.with_data, job.run.record.data.fingerprint, job.run.path)
    run = replace(job.config, data=elsewhere or here.data)
    # A noise run looks its trainings up in a table; a study needs images, which a table does not have.
    is_looked_up = run.data.facts.is_looked_up and job.header.is_noise
    source = None if is_looked_up else source_of(run)
    check_means(run)
    if is_looked_up:
        from tacevo.runs.table_answers import check_fresh

        check_fresh(run, job.header.seeds)
    catalogue = None if source is None else source.catalogue()
    if elsewhere is None:
        data = load_same(run, job.header.data, view, catalogue=catalogue)
    else:
        data = load_data(run, view, catalogue=catalogue)
        job = _on_other_data(job, elsewhere, data.facts)
    job = _grouped(job, data.facts)
    for warning in crowded(run):
        view.say(f"warning: {warning}")
    remove_leftovers_in_stores(Path(run.store.root))
    directory = find_study(job.run.directory.path, job.header, searched=bool(job.run.answered))
    units = units_of(catalogue) if data.scale and catalogue is not None else ()
    was_finished = directory.is_finished
    directory.begin(job.header, scale=data.scale, units=units, versions=versions(), machine=machine())
    workbench = Workbench(run, job.run.record.task, data.facts, Mode.record, data=data, say=view.say)
    with in_use(directory.path), workbench as bench:
        evaluator = _evaluator(bench, job.header, data.scale)
        recorded = {training.row for training in job.trainings if evaluator.is_recorded(training.source, training.seed)}
        _introduce(directory, job, elites, len(recorded), view)
        with telling(lambda: any(evaluator.is_recorded(training.source, training.seed) for training in job.trainings)):
            verdicts = _train(job.trainings, recorded, evaluator, bench.executor, view)
        has_news = not was_finished or len(recorded) < len(job.trainings)
        if not has_news:
            view.say(FINISHED_BEFORE)
        if mirror_later is not None:
            later: contextlib.AbstractContextManager[None] = contextlib.nullcontext()
        else:
            later = mirrored(run, job.run.directory, view, has_news=lambda: has_news)
        with later:  # a mirror reads studies when this is done
            digest = directory.finish(job.header, _rows(job, evaluator, verdicts))
    if mirror_later is not None:
        mirror_later.append((run, job.run.directory))
    rows = zip(job.trainings, verdicts, strict=True)
    failed = tuple(f"{training.row}: {verdict.reason}" for training, verdict in rows if isinstance(verdict, Rejection))
    return Studied(
        directory=directory.path,
        digest=digest,
        trainings=len(job.trainings),
        recorded=len(recorded),
        twice=len(evaluator.twice),
        failed=failed,
    )


def replay_studies(run: RecordedRun, view: Progress, *, seen: Seen | None = None) -> dict[str, FinishedStudy]:
    """Compare every score of a run's finished studies with the store alone; return each of them, by its name.

    Unfinished studies are passed over, and those of the run before it was extended. `seen` gets every store entry that
    is read. Where the run has no test predictions, metrics are compared with what the trainings recorded.

    Raises:
        DivergenceError: a score differs, or the study is not about the networks that the run found.
        CacheMissError: the store lacks a training.
        RunError: a file is damaged, or has more or fewer scores than it says.
    """
    studies = {}
    for directory in studies_of(run.directory.path):
        name, recorded = directory.path.name, directory.read()
        if recorded.digest is None:
            view.say(f"study {name} is not finished and is passed over")
        elif recorded.run in run.ledger.hashes[:-1]:
            view.say(f"study {name} is about the run before it was extended, and is passed over")
        else:
            with doubting(recorded.versions):
                studies[name] = directory.read_scores(recorded)
            replay_study(run, studies[name], seen=seen)
    return studies


def replay_study(
    run: RecordedRun, study: FinishedStudy, *, seen: Seen | None = None, data: Dataset | None = None
) -> None:
    """Compute the scores of one finished study of a run again, from the store alone, and compare.

    With `data`, its data set, the labels of the test images, names and scale are compared with that, too: the labels in
    the store are the word of whoever made it.

    Raises:
        DivergenceError, CacheMissError, RunError: as `replay_studies`.
    """
    with doubting(study.record.versions):
        _replay(run, study, seen, data)


def _replay(run: RecordedRun, study: FinishedStudy, seen: Seen | None, data: Dataset | None) -> None:
    """Compute the scores of one study again, and compare."""
    recorded = study.record
    trainings = recorded.seeds * len(recorded.networks)
    if len(study.rows) != trainings:  # else a few digits could ask for more memory than there is
        place = f"{study.path}/scores.jsonl"
        raise RunError(f"{len(study.rows)}", place=place, expected=f"{trainings} scores, by its study.json")
    job = study_job(
        run,
        run.config
        if recorded.is_noise  # which trains as the search did
        else trained_by(run.config, recorded.recipe, recorded.numerics, recorded.device),
        elites=len(recorded.networks) - 1,
        seeds=recorded.seeds,
        terms=recorded.terms,
        chosen_by=recorded.chosen_by,
        validated=recorded.validated,
        planned=recorded.plan,
        rules=recorded.rules,
    )
    job = _grouped(job, recorded.data)
    if recorded.other_data and recorded.data.fingerprint != run.record.data.fingerprint:
        job = replace(job, header=replace(job.header, data=recorded.data, other_data=recorded.other_data))
    place = f"{study.path}/study.json"
    if differing := misfits(recorded, job.header):
        got, expected = f"other values of {listed(differing)}", "the study that follows from the run"
        if "networks" in differing:
            got, expected = (
                f"{words} ({listed(one.id for one in networks)})"
                for words, networks in ((got, recorded.networks), (expected, job.header.networks))
            )
        raise DivergenceError(f"{got}: it was edited, or is the study of another run", place=place, expected=expected)
    check_groups(recorded, run.facts, run.config, place)
    values = recorded.data.outputs if recorded.data.kind is Kind.regression else 0
    if len(recorded.scale) != values:
        raise RunError(f"{len(recorded.scale)}", place=f"{place}, scale", expected=f"{values} values")
    if data is not None:
        _check_data(recorded, data, place)
    stores = Stores(run.stores, seen)
    with Workbench(job.config, run.record.task, job.header.data, Mode.replay, data=data, stores=stores) as bench:
        evaluator = _evaluator(bench, job.header, recorded.scale, predictions=run.has_predictions)
        verdicts = [evaluator.evaluate(training.source, training.seed) for training in job.trainings]
        digest = study.compare(job.header, _rows(job, evaluator, verdicts))
    if digest != recorded.digest:
        raise DivergenceError(str(recorded.digest), place=f"{place}, digest", expected=digest)


def _check_data(recorded: StudyRecord, data: Dataset, place: str) -> None:
    """Compare what a study says of its data with the data set itself.

    Raises:
        DivergenceError: it says something else.
    """
    facts = data.facts.as_said_by(recorded.data)
    said = {"data": (recorded.data, facts), "scale": (tuple(recorded.scale), tuple(data.scale))}
    for name, (told, loaded) in said.items():
        if told != loaded:
            raise DivergenceError(
                f"other values of {name}: it was edited",
                place=f"{place}, {name}",
                expected="those of the data set",
            )


def _evaluator(
    bench: Workbench, header: StudyHeader, scale: Sequence[float], *, predictions: bool = True
) -> Evaluator | FullEvaluator:
    """Return what trains the networks of a study, or those of a noise run."""
    if header.terms is None:
        return bench.evaluator(replace(CURRENT, training=header.rules))
    return bench.studies(header.rules, scale, predictions=predictions)


def study_job(
    run: RecordedRun,
    config: RunConfig,
    *,
    elites: int | None,
    seeds: int,
    terms: StudyTerms | None,
    chosen_by: str,
    planned: SeedPlan | None,
    rules: int,
    validated: int = 0,
) -> StudyJob:
    """Work out which networks of a run are trained, by the training of `config`, and on which terms they are judged."""
    training = rules if terms is None else TRAININGS_OF_STUDIES.get(rules, CURRENT.training)
    header = StudyHeader(
        schema=SCHEMA,
        run=run.ledger.digest,
        task=config.task.name,
        seed=config.seed,
        data=run.record.data,
        recipe=recipe_under(config, training),
        numerics=config.numerics.kind,
        device=config.training.device,
        seeds=seeds,
        terms=terms,
        networks=(),
        chosen_by=chosen_by,
        plan=planned,
        rules=rules,
        other_device=other_device(run.config, config, eager=training in EAGER),
        validated=validated,
    )
    header = replace(header, networks=_networks(run, header, elites))
    trainings = [
        _NetworkTraining(network=network, index=index, source=source, seed=_seed(header, index))
        for network in header.networks
        for source in [run.directory.read_source(network.id, network.source)]
        for index in range(seeds)
    ]
    return StudyJob(run=run, config=config, header=header, trainings=tuple(trainings))


def _networks(run: RecordedRun, header: StudyHeader, elites: int | None) -> tuple[StudyNetwork, ...]:
    """Return the networks of a study: all that were given; or the baseline and the best elites, or the chosen one."""
    if run.record.is_of_given:
        return given_networks(run.candidates, [network.name for network in run.record.task.given])
    losses = estimates_of(run.directory.path, header) if header.chosen_by else None
    if header.validated:
        elites = header.validated if header.is_choice else 1
    return networks_of(run.candidates, [elite.id for elite in run.elites], elites, losses)


def _seed(header: StudyHeader, index: int) -> int:
    """Return the training seed of a number; those that choose, those of noise runs and those that test are apart."""
    if header.is_choice:
        return choice_seed(header.seed)
    return noise_seed(header.seed, index) if header.is_noise else study_seed(header.seed, index)


def _on_other_data(job: StudyJob, data: DataConfig, facts: DataFacts) -> StudyJob:
    """Return the job on other data, of the size and kind of the run's; they may turn out to be the run's own."""
    if facts.fingerprint == job.run.record.data.fingerprint:
        return job
    differing = other_settings(job.config.data, data) or (("fingerprint", facts.fingerprint[:12]),)
    return replace(job, header=replace(job.header, data=facts, other_data=differing))


def _grouped(job: StudyJob, data: DataFacts) -> StudyJob:
    """Return the job with the groups of the test images, which a run of an earlier release does not name."""
    header = job.header
    if header.terms is None or header.data.groups or header.data.fingerprint != data.fingerprint:
        return job
    return replace(job, header=replace(header, data=replace(header.data, groups=data.groups)))


def _introduce(directory: StudyDirectory, job: StudyJob, elites: int, recorded: int, view: Progress) -> None:
    """Say what is studied, how much of it is done, and whether anything can come of it."""
    trainings = counted(len(job.trainings), "training")
    view.say(f"{job.header.what}: {directory.path} ({recorded} of {trainings} recorded already)")
    networks, terms, seeds = job.header.networks, job.header.terms, job.header.seeds
    if job.header.apart:
        view.say(job.header.apart)
    view.say(", ".join(f"{network.name}: {network.id}" for network in networks))
    if job.header.chosen_by:
        view.say(_chosen(job))
    if len(networks) <= elites and not (job.header.validated and terms):
        own = counted(len(networks) - 1, "elite")
        view.say(f"the archive has {own} with a source of its own, fewer than elites={elites}")
    if terms is not None and seeds < (needed := fewest_seeds(terms.alpha)):
        view.say(
            f"no comparison with the baseline will be possible: at alpha {terms.alpha} no outcome of seeds={seeds} is "
            f"significant; it takes seeds={needed} or more"
        )
    data = job.header.data
    if terms is not None and data.units < min(FEWEST, data.counts[2]):
        view.say(
            f"{images_tested(data)}, each of which counts once: too few for tests and intervals over them, which take "
            f"{FEWEST} or more"
        )


def _chosen(job: StudyJob) -> str:
    """Say what the elites of a study were chosen by."""
    header = job.header
    if not header.validated:
        from tacevo.results.noise_runs import noise_runs

        names = {noise.digest: noise.name for noise in noise_runs(job.run)}
        several = f", the largest of {len(names)}" if len(names) > 1 else ""
        return f"elites chosen by the noise run {names[header.chosen_by]}{several}"
    choice = chooser_of(job.run.directory.path, header)
    losses, tried = medians_of(choice), len(choice.read().networks) - 1
    if len(header.networks) == 1:
        return f"no elite of {choice.path.name} was trained to the end, so the baseline is studied alone"
    chosen = header.networks[1].id
    return (
        f"{chosen} chosen by {choice.path.name}: of {counted(tried, 'elite')} it has the lowest validation loss, "
        f"{losses[chosen]:.4g}, in a training whose seed does not test"
    )


def _train(
    trainings: Sequence[_NetworkTraining],
    recorded: Set[str],
    evaluator: Evaluator | FullEvaluator,
    executor: Executor,
    view: Progress,
) -> list[_Verdict]:
    """Train all that is not recorded, in parallel; return the verdicts in the order of the trainings.

    The progress counts only trainings that were not recorded before.
    """
    order = list(range(len(trainings)))
    # Every process takes its own order, so that two on one study rarely train the same network with the same seed.
    random.SystemRandom().shuffle(order)
    futures = {
        executor.submit(evaluator.evaluate, trainings[index].source, trainings[index].seed): index for index in order
    }
    verdicts: dict[int, _Verdict] = {}
    twice: set[str] = set()
    done = len(recorded)
    view.advance("trainings", done, len(trainings))
    for future in as_completed(futures):
        index = futures[future]
        verdict = verdicts[index] = future.result()
        if isinstance(verdict, Rejection):
            view.say(f"{trainings[index].row}: {verdict.reason}: {verdict.detail}")
        name = trainings[index].network.name
        if (trainings[index].source, trainings[index].seed) in evaluator.twice and name not in twice:
            twice.add(name)
            view.say(f"{name} learns outside its weights and buffers, so each of its trainings is made twice")
        if trainings[index].row not in recorded:
            done += 1
            view.advance("trainings", done, len(trainings))
    return [verdicts[index] for index in range(len(trainings))]


def _rows(job: StudyJob, evaluator: Evaluator | FullEvaluator, verdicts: Sequence[_Verdict]) -> list[Row]:
    """Return the lines of the scores, one for each training."""
    pairs = zip(job.trainings, verdicts, strict=True)
    settings = job.config.training
    rule: Fitness | None = None
    if job.header.is_choice:  # whatever the search's rule: the study tests the epoch of the lowest loss
        rule = Lowest()
    elif settings.fitness in FITNESS.ours:
        rule = of_settings(FITNESS, settings.fitness, settings)
    return [_row(training, evaluator.key(training.source, training.seed), verdict, rule) for training, verdict in pairs]


def _row(training: _NetworkTraining, evaluation: str, verdict: _Verdict, rule: Fitness | None) -> Row:
    if isinstance(verdict, Rejection):
        return FailedLine(
            network=training.network.name,
            id=training.network.id,
            seed=training.index,
            evaluation=evaluation,
            stage=verdict.stage,
            reason=verdict.reason,
        )
    if isinstance(verdict, Training):
        assert rule is not None  # as `tacevo.studies.noise` demands
        losses = verdict.validation_losses
        epoch = losses.index(min(losses)) + 1 if isinstance(rule, Lowest) else len(losses)
        loss, verdict = rule.of(losses), FullTraining(training=verdict, epoch=epoch, metrics={}, confusion=None)
    else:
        loss = verdict.validation_loss
    return ScoreLine(
        network=training.network.name,
        id=training.network.id,
        seed=training.index,
        evaluation=evaluation,
        epoch=verdict.epoch,
        validation_loss=loss,
        metrics=dict(verdict.metrics),
        confusion=verdict.confusion,
        predictions=verdict.training.predictions_sha256,
        weights=verdict.training.weights_sha256,
        not_deterministic=verdict.training.not_deterministic,
        captured=verdict.training.captured,
        kept=verdict.kept,
    )
