"""`tacevo replay RUN --retrain [N]`: recorded evaluations computed again and compared with their records, bit by bit.

Nothing is read from the store of evaluations and nothing is written to it. The weights' digest is computed in the
confined process, so it is that process's claim, then as now; losses of validation and digest of predictions are not.

What is trained must not be known to who made the records: N are drawn by a number of the reader's. What the findings of
a run rest on is trained in any case.
"""

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TypeVar

from tacevo.choices import Device, Numerics
from tacevo.environment import deviations, machine, versions
from tacevo.errors import DivergenceError
from tacevo.evolution.lines import TrainedLine, with_training
from tacevo.randomness import stream
from tacevo.records import Json, Mode, Reason, Rejection, Training
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import StudyDirectory, studies_of
from tacevo.rules import TRAININGS, check_known
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import Workbench, training_seed
from tacevo.sandbox.confinement import check_confinement
from tacevo.storage.run_directory import RunRecord
from tacevo.training.losses import trivial_loss
from tacevo.training.numerics import check_machine

#: Fields of a ledger line that hold a training's numbers, in the order in which they are compared.
_FIELDS = ("train_losses", "validation_losses", "predictions", "weights")

#: Why a training may end on one machine and not on another.
_BY_MACHINE = {Reason.out_of_time, Reason.out_of_memory}

#: Packages whose version may change training bits.
_COMPUTING = ("torch", "numpy")

T = TypeVar("T")

#: A training with the first run that has it.
Evaluation = tuple[RecordedRun, TrainedLine]


@dataclass(frozen=True, slots=True, kw_only=True)
class Retrained:
    """Evaluations that were found to be as recorded."""

    #: How many of those computed again are trainings, whose bits were compared.
    trained: int
    #: How many are rejections, whose reasons were compared.
    rejected: int
    #: How many evaluations the run has.
    of: int
    #: How they were chosen, in words; empty where all of them were.
    choice: str
    #: Fields that the run does not record.
    not_recorded: tuple[str, ...]
    #: Why equal bits were not promised; empty where they were.
    doubts: tuple[str, ...]


def retrain(runs: Sequence[RecordedRun], count: int | None, draw: int, view: Progress) -> Retrained:
    """Train candidates of finished runs again, and compare every bit that the runs recorded of them.

    An evaluation that several runs share counts once.

    Args:
        runs: one, or those of a sweep.
        count: how many evaluations to draw beside the decisive ones; None for all of them.
        draw: the number that the draw follows from, which no author of the records may know.
        view: shows the progress.

    Raises:
        DivergenceError: the first difference.
        DataError: a run's data set is missing, or is another one.
        ConfigError: this machine cannot compute what a run's numerics ask for.
        RunError: a candidate's source is missing or was edited, run.json is damaged, or this release's trainer cannot
            train as the run's did.
    """
    pairs = evaluations(runs)
    drawn, choice = chosen(pairs, decisive(runs), count, draw)
    if choice:
        view.say(choice)
    doubts: dict[str, None] = {}
    for run in runs:
        name = f"{run.directory.path.name} " if len(runs) > 1 else ""
        if lines := [line for of, line in drawn if of is run]:
            doubts |= dict.fromkeys(_retrain(run, lines, view, name))
    trained = [line for _, line in drawn if line.stage is None]
    return Retrained(
        trained=len(trained),
        rejected=len(drawn) - len(trained),
        of=len(pairs),
        choice=choice,
        not_recorded=tuple(name for name in _FIELDS if any(getattr(line, name) is None for line in trained)),
        doubts=tuple(doubts),
    )


def decisive(runs: Iterable[RecordedRun]) -> set[str]:
    """Return the keys of the evaluations of each run's best network, and of all networks of its finished studies.

    These are what a forger gains by, so no draw may miss them. The networks of noise runs, mostly all elites, are not
    among them.
    """
    keys: set[str] = set()
    for run in runs:
        sources = {line.id: line.source for line in run.candidates}
        elites = run.elites
        lowest = min((elite.fitness for elite in elites), default=None)
        networks = {sources[elite.id] for elite in elites if elite.fitness == lowest}
        for study in map(StudyDirectory.read, studies_of(run.directory.path)):
            if study.terms is not None and study.digest is not None and study.run == run.ledger.digest:
                networks.update(network.source for network in study.networks)
        trained = (line for line in run.ledger.lines if isinstance(line, TrainedLine) and line.source in networks)
        keys.update(one.evaluation for line in trained for one in line.by_seed() if one.evaluation is not None)
    return keys


def chosen(
    pairs: Sequence[Evaluation], decisive: Set[str], count: int | None, draw: int
) -> tuple[list[Evaluation], str]:
    """Choose the decisive evaluations and `count` of the others, in their order; say how, and with which odds."""
    others = [pair for pair in pairs if pair[1].evaluation not in decisive]
    if count is None or count >= len(others):
        return list(pairs), ""
    drawn = {pair[1].evaluation for pair in sampled(others, count, draw)}
    taken = [pair for pair in pairs if pair[1].evaluation in drawn or pair[1].evaluation in decisive]
    return taken, (
        f"{len(taken) - count} evaluations of best networks and of networks of studies, and {count} of the other "
        f"{len(others)}, drawn at random (--draw {draw} repeats this): a forged one among these {len(others)} is found "
        f"with a chance of {100 * count / len(others):.1f} %"
    )


def evaluations(runs: Sequence[RecordedRun]) -> list[Evaluation]:
    """List the evaluations of all runs whose outcome does not depend on the machine's speed or memory.

    Each is listed once, with the first run and line that have it; of several seeds each has its own line
    (`TrainedLine.by_seed`).
    """
    found: dict[str, Evaluation] = {}
    for run in runs:
        check_known("training", run.rules.training, TRAININGS, run.directory.path)
        for line in run.ledger.lines:
            for one in line.by_seed() if isinstance(line, TrainedLine) else ():
                if one.evaluation is not None and one.reason not in _BY_MACHINE:
                    found.setdefault(one.evaluation, (run, one))
    return list(found.values())


def _retrain(run: RecordedRun, lines: Sequence[TrainedLine], view: Progress, name: str) -> tuple[str, ...]:
    """Train candidates of one run again, by its rules, and compare; say why equal bits were not promised.

    `name` stands before a candidate's id; it is empty where there is one run only.
    """
    config = run.config
    check_confinement(config.sandbox.require)
    check_machine(config.numerics.kind, config.training.device, config.training.gpu)
    doubts = doubts_of(run.record, config.numerics.kind, config.training.device, versions(), machine())
    for doubt in doubts:
        view.say(f"equal bits are not promised: {doubt}")
    jobs = [
        (run.directory.read_source(line.id, str(line.source)), training_seed(config.seed, line.seed)) for line in lines
    ]
    data = load_same(config, run.record.data, view)
    _check_trivial(run, trivial_loss(run.record.task.contract.loss, data.targets[data.validation]))
    with Workbench(config, run.record.task, data.facts, Mode.live, data=data) as bench:
        evaluator = bench.evaluator(run.rules)
        retrained = bench.executor.map(lambda job: evaluator.retrain(*job), jobs)
        results = zip(lines, retrained, strict=True)
        for number, (line, result) in enumerate(results, start=1):
            _check_equal(name, line, result, doubts)
            seed = f", seed {line.seed}" if line.seed else ""
            view.say(f"{name}{line.id}{seed}: as recorded ({number} of {len(lines)})")
    return doubts


def describe(found: Retrained) -> str:
    """Say what was compared, for a person."""
    recorded = [name for name in _FIELDS if name not in found.not_recorded]
    lines = [f"retrained: {found.trained + found.rejected} of {found.of} evaluations"]
    lines += [found.choice] if found.choice else []
    if found.trained and recorded:
        lines.append(f"trained: {found.trained}; {', '.join(recorded)} are bit for bit as recorded")
    if found.rejected:
        lines.append(f"rejected: {found.rejected}, for the recorded reasons")
    if found.not_recorded:
        lines.append(f"not recorded, hence not compared: {', '.join(found.not_recorded)}")
    return "\n".join(lines)


def sampled(lines: Sequence[T], count: int | None, seed: int) -> list[T]:
    """Draw lines without repetition, in their order; all of them where `count` is None or not below their number."""
    if count is None or count >= len(lines):
        return list(lines)
    places = stream(seed, "retrain").choice(len(lines), count, replace=False)
    return [lines[place] for place in sorted(places.tolist())]


def difference(line: TrainedLine, result: Training | Rejection) -> str | None:
    """Name the first field in which a recomputed evaluation differs from its ledger line, with both values.

    Fields that the line does not have are passed over.
    """
    if isinstance(result, Rejection) or line.reason is not None:
        recorded, recomputed = _outcome(line.reason), _outcome(getattr(result, "reason", None))
        return None if recorded == recomputed else _differ("the outcome", recorded, recomputed)
    computed = with_training(line, result)
    for name in _FIELDS:
        was, now = getattr(line, name), getattr(computed, name)
        if was is None or was == now:
            continue
        if isinstance(was, str) or len(was) != len(now):
            return _differ(name, was, now)
        epoch = next(epoch for epoch, pair in enumerate(zip(was, now, strict=True)) if pair[0] != pair[1])
        return _differ(f"{name} of epoch {epoch + 1}", was[epoch], now[epoch])
    return None


def doubts_of(
    run: RunRecord,
    numerics: Numerics,
    device: Device,
    packages: Mapping[str, str],
    hardware: Mapping[str, Json],
) -> tuple[str, ...]:
    """Say why this machine is not promised to reproduce a run's training bits.

    `fast` numerics promise bits on the recorded hardware only, `cuda` on the recorded model of GPU only.
    """
    doubts = deviations({name: run.versions.get(name) for name in _COMPUTING}, packages)
    promised_by = ["cpu", "architecture"] if numerics is Numerics.fast else []
    promised_by += ["gpu"] if device is Device.cuda else []
    return doubts + deviations({name: run.machine.get(name) for name in promised_by}, hardware)


def _check_trivial(run: RecordedRun, trivial: float) -> None:
    """Compare the trivial loss that a run names, if it names one, with that of its data set."""
    if run.record.trivial not in {None, trivial}:
        place = f"{run.directory.path}/run.json, trivial"
        raise DivergenceError(str(run.record.trivial), place=place, expected=f"{trivial}, by the validation labels")


def _outcome(reason: Reason | None) -> str:
    return "trained" if reason is None else reason.value


def _differ(what: str, recorded: object, recomputed: object) -> str:
    return f"{what}: recorded {recorded}, recomputed {recomputed}"


def _check_equal(name: str, line: TrainedLine, result: Training | Rejection, doubts: Sequence[str]) -> None:
    """Raise for the first difference, with what explains it beside the candidate."""
    found = difference(line, result)
    if found is None:
        return
    reasons = [f"not promised: {doubt}" for doubt in doubts]
    if isinstance(result, Rejection) and result.reason in _BY_MACHINE:
        reasons.append("this depends on the machine's speed and memory; try with executor.workers=1 or a quiet machine")
    if line.not_portable:
        reasons.append(f"the candidate uses {', '.join(line.not_portable)}, whose bits depend on the CPU")
    raise DivergenceError(found, place=f"{name}{line.id}", remedy="; ".join(reasons))
