"""The trainings whose weights are exported: which they are, what is recorded of them, and how they went again."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import partial
from typing import Annotated

from annotated_types import Ge, Le

from tacevo.config.compose import compose_study
from tacevo.config.schema import OneToMillion, RunConfig, TrainingConfig, is_a
from tacevo.data.dataset import Dataset
from tacevo.environment import machine, versions
from tacevo.errors import CacheMissError, DivergenceError, RunError
from tacevo.evolution.lines import CandidateLine, of_training
from tacevo.export.epochs import EpochCount
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.records import Mode, Record, Rejection, Training
from tacevo.reproduce.retrain import doubts_of
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import FinishedStudy, studies_of
from tacevo.results.study_lines import Row, ScoreLine
from tacevo.rules import CHOSEN_SINCE, KEPT_SINCE, STUDY, TRAININGS, TRAININGS_OF_STUDIES, check_known
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import study_seed, training_seed
from tacevo.runs.wiring import Workbench, trained_by
from tacevo.storage.array_store import digest_of
from tacevo.storage.store import Stores
from tacevo.studies.study import replay_study
from tacevo.text import counted, lasting, listed
from tacevo.training.evaluation import Evaluator
from tacevo.training.full import FullEvaluator, FullTraining
from tacevo.training.weights import Weighed

_Evaluator = Evaluator | FullEvaluator

#: Seconds of an export beside its trainings, roughly: the libraries of ONNX take most of it to start.
CONVERTING = 15.0


class Like(StrEnum):
    """The training that is repeated."""

    #: All epochs of a study, and the weights of the best validation epoch.
    study = "study"
    #: The epochs of the search, and the weights of its last epoch.
    search = "search"


def _is_licence(name: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9.+-]+", name) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSettings(Record):
    """The settings of an export."""

    #: Trainings; several are an ensemble.
    seeds: Annotated[int, Ge(1), Le(100)] = 1
    #: The number of epochs; None for that of the study or the search.
    epochs: OneToMillion | None = None
    like: Like = Like.study
    #: The licence of the model, as its card names it.
    licence: Annotated[str, is_a("the identifier of a licence, such as CC-BY-4.0", _is_licence)] = "CC-BY-4.0"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """The plan of a candidate's trainings."""

    line: CandidateLine
    like: Like
    #: The configuration of the run, with this training.
    config: RunConfig
    #: The seed of each training, as torch gets it.
    seeds: tuple[int, ...]
    #: Number of the rules of a study or, like a search, of training.
    rules: int
    #: The study that tested this network so; None without one.
    study: FinishedStudy | None
    #: The scores that the study found, one for each of its seeds; computed again from its test predictions.
    scores: tuple[ScoreLine, ...]
    #: The reason why its scores cannot be computed again, and are not cited; empty where they can be.
    uncited: str
    #: The lines of the trainings that the run recorded, and those of its finished studies that follow from the stores,
    #: by key. The store may have others of its own.
    recorded: Mapping[str, CandidateLine | Row]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """One training with its weights."""

    weighed: Weighed
    seed: int
    #: The epoch, from 1, whose weights these are.
    epoch: int
    #: The key of the training in the store.
    key: str
    #: Whether the run or a study of it recorded this training.
    was_recorded: bool
    #: The names of the fields of `Training` that differ from the record or, where there is none, from another training
    #: with this seed; None where there is neither.
    differing: tuple[str, ...] | None


def design(
    run: RecordedRun, line: CandidateLine, settings: ExportSettings, data: Dataset | None = None
) -> TrainingPlan:
    """Work out how a candidate is trained: as the run's first study of it, else as a study by default.

    With `data`, the loaded data set of the run, its studies are compared with that, too.

    Raises:
        DivergenceError: a study of it does not follow from the stores and the data.
    """
    config, like = run.config, settings.like
    studies = _studies(run, line, data) if like is Like.study else []
    study, missing = None, ""
    if like is Like.search:
        seeds = tuple(training_seed(config.seed, number) for number in range(settings.seeds))
        rules = run.rules.training
    else:
        seeds = tuple(study_seed(config.seed, number) for number in range(settings.seeds))
        fitting = [pair for pair in studies if settings.epochs in {None, pair[0].record.recipe.epochs}]
        study, missing = fitting[0] if fitting else (None, "")
        if study is None:
            given, rules = compose_study(["run=RUN"]), STUDY
            training = replace(config.training, epochs=given.epochs, seconds=given.seconds, memory_mib=given.memory_mib)
            config = replace(config, training=training)
        else:
            record, rules = study.record, study.record.rules
            config = trained_by(config, record.recipe, record.numerics, record.device)
    training = replace(config.training, epochs=settings.epochs or config.training.epochs)
    rows = () if study is None else study.rows
    scores = tuple(row for row in rows if row.id == line.id and isinstance(row, ScoreLine))
    uncited = "" if study is None else missing or _without_predictions(run, study)
    recorded: dict[str, CandidateLine | Row] = {
        one.evaluation: one for one in run.candidates if one.evaluation is not None
    }
    for one, lacking in studies:
        recorded |= {} if lacking else {row.evaluation: row for row in one.rows}
    return TrainingPlan(
        line=line,
        like=like,
        config=replace(config, training=training),
        seeds=seeds,
        rules=rules,
        study=study,
        scores=() if uncited else scores,
        uncited=uncited,
        recorded=recorded,
    )


def _studies(run: RecordedRun, line: CandidateLine, data: Dataset | None) -> list[tuple[FinishedStudy, str]]:
    """List the finished studies of this network on the run's data and device; today's rules and its numerics first.

    Each with what the stores lack of it; empty where all of its scores follow from them.

    Raises:
        DivergenceError: the scores of one do not.
    """
    known = [(directory, directory.read()) for directory in studies_of(run.path)]
    fitting = [
        directory.read_scores(record)
        for directory, record in known
        if record.terms is not None
        and record.digest is not None
        and record.run == run.digest
        and not record.other_data
        and record.device is run.config.training.device  # so that no study of a bundle takes the walls down
        and line.id in {network.id for network in record.networks}
    ]
    fitting.sort(key=lambda study: (-study.record.rules, bool(study.record.other_device)))
    return [(study, _missing(run, study, data)) for study in fitting]


def _missing(run: RecordedRun, study: FinishedStudy, data: Dataset | None) -> str:
    """Compare a study with what the stores and the data give; say what the stores lack."""
    try:
        replay_study(run, study, data=data)
    except CacheMissError:  # which names directories of this machine
        return "the stores lack a training of it, or its test predictions"
    except RunError as error:  # what it rests on is gone, such as the noise run that chose its networks
        return f"expected {error.expected}; got {error.got}"
    except DivergenceError as error:
        remedy = "the study was edited, or is damaged; like=search exports the network without any study"
        error.remedy = f"{error.remedy}; {remedy}" if error.remedy else remedy
        raise
    return ""


def _without_predictions(run: RecordedRun, study: FinishedStudy) -> str:
    """Say why the metrics of a study cannot be computed from test predictions; empty where they can be."""
    if study.record.rules < KEPT_SINCE:
        return f"studies under rules {study.record.rules} kept no test predictions"
    return "" if run.has_predictions else "the bundle of a sweep holds no test predictions"


def train(
    run: RecordedRun, plan: TrainingPlan, source: str, data: Dataset, view: Progress, *, retrained: bool
) -> tuple[list[Trained], tuple[str, ...]]:
    """Train a network with every seed of a plan and compare with what is recorded.

    Where a study's training is not in the store, it is trained once more, before: only its end says which epoch is
    best. The first of the two is stored as a study stores it, under today's rules alone, and stays no record.

    Returns:
        The trainings in the order of the seeds, and why equal bits were not promised.

    Raises:
        DivergenceError: with `retrained`, a training differs from its record.
        RunError: with `retrained`, one is not recorded; or one came to no end.
        SandboxError: the sandbox is broken.
    """
    config, record = plan.config, run.record
    if plan.like is Like.search:
        check_known("training", plan.rules, TRAININGS, run.path)
    else:
        check_known("study", plan.rules, TRAININGS_OF_STUDIES, run.path)
    doubts = doubts_of(
        plan.study.record if plan.study else record, config.numerics.kind, config.training.device, versions(), machine()
    )
    trained: list[Trained] = []
    with (
        Workbench(config, record.task, data.facts, Mode.replay, stores=Stores(run.stores)) as stored,
        Workbench(config, record.task, data.facts, Mode.record, data=data) as bench,
    ):
        known = _evaluator(stored, run, plan, data, predictions=run.has_predictions)
        fresh = _evaluator(bench, run, plan, data, predictions=plan.rules == STUDY)
        for seed in plan.seeds if retrained else ():
            _check_recorded(known, plan, source, seed)
        are_known = all(known.is_recorded(source, seed) for seed in plan.seeds)
        long = _lasts(run, plan, twice=plan.like is Like.study and not are_known)
        what = f"training {counted(len(plan.seeds), 'network')} for {counted(config.training.epochs, 'epoch')}"
        view.say(what if long is None else f"{what}; all of it takes {lasting(long)}, by the times of the run")
        epochs, took = config.training.epochs, run.cpu_seconds.get(plan.line.id)
        before = [seed for seed in plan.seeds if plan.like is Like.study and not known.is_recorded(source, seed)]
        pace = None if took is None else took / run.config.training.epochs
        count = EpochCount(view, epochs * (len(plan.seeds) + len(before)), pace)
        bench.on_epoch = count.told
        again = partial(_train, bench, (known, fresh), plan, source, count=count)
        for one in bench.executor.map(again, plan.seeds):
            view.say(
                f"trained ({len(trained) + 1} of {len(plan.seeds)}); the weights are those after epoch {one.epoch}"
            )
            trained.append(one)
    if retrained:
        _check_equal(trained, doubts)
    return trained, doubts


def _lasts(run: RecordedRun, plan: TrainingPlan, *, twice: bool) -> float | None:
    """Estimate the seconds of an export from the time that the network's trainings took in the run; None without it."""
    took, was = run.cpu_seconds.get(plan.line.id), run.config.training
    if took is None:
        return None
    one = took * plan.config.training.epochs / was.epochs * (2 if twice else 1)
    rounds = -(-len(plan.seeds) // plan.config.executor.workers)
    return one * rounds + CONVERTING


def _train(
    bench: Workbench,
    evaluators: tuple[_Evaluator, _Evaluator],
    plan: TrainingPlan,
    source: str,
    seed: int,
    *,
    count: EpochCount,
) -> Trained:
    """Train a network with one seed; of the evaluators, one reads what is recorded, the other trains and stores."""
    known, fresh = evaluators
    is_stored, told = known.is_recorded(source, seed), None
    if is_stored:
        told = known.evaluate(source, seed)
    elif plan.like is Like.study:
        with count.telling(plan.config.training.epochs):
            told = (fresh.evaluate if plan.rules == STUDY else fresh.retrain)(source, seed)
    epoch = told.epoch if isinstance(told, FullTraining) else plan.config.training.epochs
    if isinstance(told, Rejection):
        raise _failed(told)
    training = plan.rules if plan.like is Like.search else TRAININGS_OF_STUDIES[plan.rules]
    with count.paced(plan.config.training.epochs):
        weighed = bench.weigh(source, seed, epoch, training)
    if isinstance(weighed, Rejection):
        raise _failed(weighed)
    key = known.key(source, seed)
    record = plan.recorded.get(key) if is_stored else None
    differing = _differing(told, weighed, plan.rules)
    if isinstance(record, CandidateLine) and differing is not None:
        differing = tuple(
            dict.fromkeys([*differing, *_differing_from_line(record, weighed.training, plan.config.training)])
        )
    return Trained(
        weighed=weighed, seed=seed, epoch=epoch, key=key, was_recorded=record is not None, differing=differing
    )


def _check_recorded(known: _Evaluator, plan: TrainingPlan, source: str, seed: int) -> None:
    key = known.key(source, seed)
    if not (key in plan.recorded and known.is_recorded(source, seed)):
        raise RunError(
            "no record of it",
            place=f"training {key[:12]}",
            expected="a training that the run or a finished study of it recorded",
            remedy="leave out --retrained",
        )


def _check_equal(trained: Sequence[Trained], doubts: Sequence[str]) -> None:
    for one in trained:
        if one.differing:
            raise DivergenceError(
                f"other {listed(one.differing)}",
                place=f"training {one.key[:12]}",
                expected="the recorded training",
                remedy="; ".join(f"not promised: {doubt}" for doubt in doubts),
            )


def _evaluator(
    bench: Workbench, run: RecordedRun, plan: TrainingPlan, data: Dataset, *, predictions: bool
) -> _Evaluator:
    if plan.like is Like.search:
        return bench.evaluator(run.rules)
    return bench.studies(plan.rules, data.scale, predictions=predictions)


def _differing(told: FullTraining | Training | None, weighed: Weighed, rules: int) -> tuple[str, ...] | None:
    """Name the fields in which a training differs from what is told of it; None where nothing is."""
    if told is None:
        return None
    was, now = (told.training if isinstance(told, FullTraining) else told), weighed.training
    if isinstance(told, FullTraining) and rules < CHOSEN_SINCE:
        now = weighed.tested
    names = [field.name for field in fields(Training) if getattr(was, field.name) != getattr(now, field.name)]
    if isinstance(told, FullTraining) and told.kept and digest_of(weighed.predictions) != told.kept.predictions:
        names.append("test_predictions")
    return tuple(names)


def _differing_from_line(line: CandidateLine, now: Training, config: TrainingConfig) -> list[str]:
    """Name what the ledger says otherwise; a ledger of an earlier release does not say all of it.

    A fitness by a part that the run's user brought is not computed: nothing of it runs here.
    """
    said = of_training(now)
    if config.fitness in FITNESS.ours:
        said["fitness"] = of_settings(FITNESS, config.fitness, config).of(now.validation_losses)
    names = ("train_losses", "validation_losses", "predictions", "weights", "fitness")
    return [name for name in names if name in said and getattr(line, name) not in {None, said[name]}]


def _failed(rejection: Rejection) -> RunError:
    return RunError(
        f"{rejection.reason}: {rejection.detail}",
        place="training",
        expected="a network that trains to the end",
        remedy="choose another candidate, or epochs=",
    )
