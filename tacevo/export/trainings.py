"""The trainings whose weights are exported: which they are, what is recorded of them, and how they went again."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Annotated

from annotated_types import Ge, Le

from tacevo.config.compose import compose_study
from tacevo.config.schema import OneToMillion, RunConfig, is_a
from tacevo.data.dataset import Dataset
from tacevo.environment import machine, versions
from tacevo.errors import DivergenceError, RunError
from tacevo.evolution.lines import CandidateLine, TrainedLine
from tacevo.randomness import derived_seed
from tacevo.records import Mode, Record, Rejection, Training
from tacevo.reproduce.retrain import doubts_of
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import FinishedStudy, studies_of
from tacevo.results.study_lines import ScoreLine
from tacevo.rules import CHOSEN_SINCE, STUDY, TRAININGS, TRAININGS_OF_STUDIES, check_known
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import Workbench, trained_by, training_seed
from tacevo.storage.store import Stores
from tacevo.text import counted, listed
from tacevo.training.evaluation import Evaluator
from tacevo.training.full import FullEvaluator, FullTraining
from tacevo.training.weights import Weighed

_Evaluator = Evaluator | FullEvaluator


class Like(StrEnum):
    """Which training is repeated."""

    #: All epochs of a study, and the weights of the best validation epoch.
    study = "study"
    #: That of the search, and the weights of its last epoch.
    search = "search"


def _is_licence(name: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9.+-]+", name) is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSettings(Record):
    """What a user may set."""

    #: Trainings; several are an ensemble.
    seeds: Annotated[int, Ge(1), Le(100)] = 1
    #: None for those of the study or the search.
    epochs: OneToMillion | None = None
    like: Like = Like.study
    #: Of the model, as its card names it.
    licence: Annotated[str, is_a("the identifier of a licence, such as CC-BY-4.0", _is_licence)] = "CC-BY-4.0"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingPlan:
    """How a candidate is trained."""

    like: Like
    #: Of the run, with this training.
    config: RunConfig
    #: Of each training, as torch gets them.
    seeds: tuple[int, ...]
    #: Number of the rules of a study or, like a search, of training.
    rules: int
    #: The study that tested this network so; None without one.
    study: FinishedStudy | None
    #: What that study found, one for each of its seeds.
    scores: tuple[ScoreLine, ...]
    #: Keys of the trainings that the run, or a finished study of it, recorded. The store may have others of its own.
    recorded: frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """One training with its weights."""

    weighed: Weighed
    seed: int
    #: Whose weights these are, from 1.
    epoch: int
    #: Of the training in the store.
    key: str
    #: Whether the run or a study of it recorded this training.
    was_recorded: bool
    #: What differs from the record or, where there is none, from another training with this seed: names of fields of
    #: `Training`; None where there is neither.
    differing: tuple[str, ...] | None


def design(run: RecordedRun, line: CandidateLine, settings: ExportSettings) -> TrainingPlan:
    """Work out how a candidate is trained: as the run's first study of it, else as a study by default."""
    config, like, studies = run.config, settings.like, _studies(run, line)
    study = None
    if like is Like.search:
        seeds = tuple(training_seed(config.seed, number) for number in range(settings.seeds))
        rules = run.rules.training
    else:
        seeds = tuple(derived_seed(config.seed, "study", number) for number in range(settings.seeds))
        study = next((one for one in studies if settings.epochs in {None, one.record.recipe.epochs}), None)
        if study is None:
            given, rules = compose_study(["run=RUN"]), STUDY
            training = replace(config.training, epochs=given.epochs, seconds=given.seconds, memory_mib=given.memory_mib)
            config = replace(config, training=training)
        else:
            record, rules = study.record, study.record.rules
            config = trained_by(config, record.recipe, record.numerics, record.device)
    training = replace(config.training, epochs=settings.epochs or config.training.epochs)
    rows = () if study is None else study.scores.rows
    searched = [one for of in run.ledger.lines if isinstance(of, TrainedLine) for one in of.by_seed()]
    recorded = {one.evaluation for one in searched} | {row.evaluation for one in studies for row in one.scores.rows}
    return TrainingPlan(
        like=like,
        config=replace(config, training=training),
        seeds=seeds,
        rules=rules,
        study=study,
        scores=tuple(row for row in rows if row.id == line.id and isinstance(row, ScoreLine)),
        recorded=frozenset(key for key in recorded if key is not None),
    )


def _studies(run: RecordedRun, line: CandidateLine) -> list[FinishedStudy]:
    """List the finished studies of this network on the run's data and device; today's rules and its numerics first."""
    known = [(directory, directory.read()) for directory in studies_of(run.path)]
    fitting = [
        FinishedStudy(path=directory.path, record=record, scores=directory.read_scores())
        for directory, record in known
        if record.terms is not None
        and record.digest is not None
        and record.run == run.digest
        and not record.other_data
        and record.device is run.config.training.device  # so that no study of a bundle takes the walls down
        and line.id in {network.id for network in record.networks}
    ]
    return sorted(fitting, key=lambda study: (-study.record.rules, bool(study.record.other_device)))


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
        view.say(f"training {counted(len(plan.seeds), 'network')} for {counted(config.training.epochs, 'epoch')}")
        for one in bench.executor.map(lambda seed: _train(bench, (known, fresh), plan, source, seed), plan.seeds):
            view.say(
                f"trained ({len(trained) + 1} of {len(plan.seeds)}); the weights are those after epoch {one.epoch}"
            )
            trained.append(one)
    if retrained:
        _check_equal(trained, doubts)
    return trained, doubts


def _train(
    bench: Workbench, evaluators: tuple[_Evaluator, _Evaluator], plan: TrainingPlan, source: str, seed: int
) -> Trained:
    """Train a network with one seed; of the evaluators, one reads what is recorded, the other trains and stores."""
    known, fresh = evaluators
    is_stored, told = known.is_recorded(source, seed), None
    if is_stored:
        told = known.evaluate(source, seed)
    elif plan.like is Like.study:
        told = (fresh.evaluate if plan.rules == STUDY else fresh.retrain)(source, seed)
    epoch = told.epoch if isinstance(told, FullTraining) else plan.config.training.epochs
    if isinstance(told, Rejection):
        raise _failed(told)
    training = plan.rules if plan.like is Like.search else TRAININGS_OF_STUDIES[plan.rules]
    weighed = bench.weigh(source, seed, epoch, training)
    if isinstance(weighed, Rejection):
        raise _failed(weighed)
    return Trained(
        weighed=weighed,
        seed=seed,
        epoch=epoch,
        key=known.key(source, seed),
        was_recorded=is_stored and known.key(source, seed) in plan.recorded,
        differing=_differing(told, weighed, plan.rules),
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
    return tuple(field.name for field in fields(Training) if getattr(was, field.name) != getattr(now, field.name))


def _failed(rejection: Rejection) -> RunError:
    return RunError(
        f"{rejection.reason}: {rejection.detail}",
        place="training",
        expected="a network that trains to the end",
        remedy="choose another candidate, or epochs=",
    )
