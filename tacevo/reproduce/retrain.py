"""`tacevo replay RUN --retrain [N]`: recorded evaluations computed again and compared with their records, bit by bit.

Nothing is read from the store of evaluations and nothing is written to it. The weights' digest is computed in the
confined process, so it is that process's claim, then as now; losses of validation and digest of predictions are not.

What is trained must not be known to who made the records: N are drawn by a number of the reader's. What the findings of
a run rest on is trained in any case.
"""

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import TYPE_CHECKING, TypeVar

from tacevo.choices import Device, Numerics
from tacevo.environment import deviations, machine, versions
from tacevo.errors import DivergenceError
from tacevo.evolution.lines import CandidateLine, of_training
from tacevo.randomness import stream
from tacevo.records import Json, Mode, Reason, Rejection, Training
from tacevo.results.run import RecordedRun
from tacevo.results.study_directory import StudyDirectory, studies_of
from tacevo.results.study_lines import StudyRecord
from tacevo.rules import TRAININGS, check_known
from tacevo.runs.datasets import load_same, trivial_of
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.confinement import check_confinement
from tacevo.storage.run_directory import RunRecord
from tacevo.training.numerics import check_machine

if TYPE_CHECKING:
    from tacevo.results.table_records import Header

#: Fields of a ledger line that hold a training's numbers, in the order in which they are compared.
_FIELDS = ("train_losses", "validation_losses", "predictions", "weights")

#: The reasons for which a training may end on one machine and not on another.
BY_MACHINE = {Reason.out_of_time, Reason.out_of_memory}

#: Packages whose version may change training bits.
_COMPUTING = ("torch", "numpy")

T = TypeVar("T")

#: A training with the first run that has it.
Evaluation = tuple[RecordedRun, CandidateLine]


def retrain(runs: Sequence[RecordedRun], count: int | None, draw: int, view: Progress) -> str:
    """Train candidates of finished runs again, and compare every bit that the runs recorded; say what was compared.

    An evaluation that several runs share counts once.

    Args:
        runs: one, or those of a sweep.
        count: how many evaluations to draw beside the decisive ones; None for all of them.
        draw: the number that the draw follows from, which no author of the records may know.
        view: shows the progress, and why equal bits are not promised.

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
    for run in runs:
        name = f"{run.path.name} " if len(runs) > 1 else ""
        if lines := [line for of, line in drawn if of is run]:
            _retrain(run, lines, view, name)
    tables = dict.fromkeys(str(run.config.data.root) for run in runs if run.config.data.facts.is_looked_up)
    looked_up = [
        f"nothing was trained: these were looked up in {table} again, whose rows `tacevo replay {table} --retrain N` "
        "trains"
        for table in tables
    ]
    did = "looked up" if all(run.config.data.facts.is_looked_up for run in runs) else "trained"
    return "\n".join([describe([line for _, line in drawn], len(pairs), choice, did), *looked_up])


def decisive(runs: Iterable[RecordedRun]) -> set[str]:
    """Return the keys of the evaluations of each run's best network, and of all networks of its finished studies.

    These are what a forger gains by, so no draw may miss them. The networks of noise runs, mostly all elites, are not
    among them.
    """
    keys: set[str] = set()
    for run in runs:
        sources = {line.id: line.source for line in run.candidates}
        lowest = min((elite.fitness for elite in run.elites), default=None)
        networks = {sources[elite.id] for elite in run.elites if elite.fitness == lowest}
        for study in map(StudyDirectory.read, studies_of(run.path)):
            if study.terms is not None and study.digest is not None and study.run == run.digest:
                networks.update(network.source for network in study.networks)
        trained = (line for line in run.candidates if line.source in networks)
        keys.update(line.evaluation for line in trained if line.evaluation is not None)
    return keys


def chosen(
    pairs: Sequence[Evaluation], decisive: Set[str], count: int | None, draw: int
) -> tuple[list[Evaluation], str]:
    """Choose the decisive evaluations and `count` of the others, in their order; say how, and with which odds."""
    others = [line.evaluation for _, line in pairs if line.evaluation not in decisive]
    if count is None or count >= len(others):
        return list(pairs), ""
    keys = {*decisive, *sampled(others, count, draw)}
    taken = [pair for pair in pairs if pair[1].evaluation in keys]
    return taken, (
        f"{len(taken) - count} evaluations of best networks and of networks of studies, and {count} of the other "
        f"{len(others)}, drawn at random (--draw {draw} repeats this): a forged one among these {len(others)} is found "
        f"with a chance of {100 * count / len(others):.1f} %"
    )


def evaluations(runs: Sequence[RecordedRun]) -> list[Evaluation]:
    """List the evaluations of all runs whose outcome does not depend on the machine's speed or memory.

    Each is listed once, with the first run and line that have it.
    """
    pairs: dict[str, Evaluation] = {}
    for run in runs:
        check_known("training", run.rules.training, TRAININGS, run.directory.path)
        for line in run.candidates:
            if line.evaluation is not None and line.reason not in BY_MACHINE:
                pairs.setdefault(line.evaluation, (run, line))
    return list(pairs.values())


def _retrain(run: RecordedRun, lines: Sequence[CandidateLine], view: Progress, name: str) -> None:
    """Train candidates of one run again, by its rules, and compare; `name` stands before a candidate's id."""
    config = run.with_data
    check_confinement(config.sandbox.require)
    check_machine(config.numerics.kind, config.training.device, config.training.gpu)
    doubts = doubts_of(run.record, config.numerics.kind, config.training.device, versions(), machine())
    for doubt in doubts:
        view.say(f"equal bits are not promised: {doubt}")
    sources = [run.directory.read_source(line.id, str(line.source)) for line in lines]
    seed = training_seed(config.seed, 0)
    data = load_same(config, run.record.data, view)
    _check_trivial(run, trivial_of(config, run.record.task, data))
    with Workbench(config, run.record.task, data.facts, Mode.live, data=data) as bench:
        evaluator = bench.evaluator(run.rules)
        retrained = bench.executor.map(lambda source: evaluator.retrain(source, seed), sources)
        results = zip(lines, retrained, strict=True)
        for number, (line, result) in enumerate(results, start=1):
            _check_equal(name, line, result, doubts)
            view.say(f"{name}{line.id}: as recorded ({number} of {len(lines)})")


def describe(lines: Sequence[CandidateLine], of: int, choice: str, did: str = "trained") -> str:
    """Say what was compared, for a person: these of so many evaluations, how they were chosen, and what was done."""
    trained = [line for line in lines if line.stage is None]
    lacking = [name for name in _FIELDS if any(getattr(line, name) is None for line in trained)]
    recorded = [name for name in _FIELDS if name not in lacking]
    again = "retrained" if did == "trained" else f"{did} again"
    said = [f"{again}: {len(lines)} of {of} evaluations", *([choice] if choice else [])]
    if trained and recorded:
        said.append(f"{did}: {len(trained)}; {', '.join(recorded)} are bit for bit as recorded")
    if len(trained) < len(lines):
        said.append(f"rejected: {len(lines) - len(trained)}, for the recorded reasons")
    if lacking:
        said.append(f"not recorded, hence not compared: {', '.join(lacking)}")
    return "\n".join(said)


def sampled(keys: Sequence[T], count: int, seed: int) -> list[T]:
    """Draw keys without repetition, in their order."""
    indices = stream(seed, "retrain").choice(len(keys), count, replace=False)
    return [keys[index] for index in sorted(indices.tolist())]


def difference(line: CandidateLine, result: Training | Rejection) -> str | None:
    """Name the first field in which a recomputed evaluation differs from its ledger line, with both values.

    Fields that the line does not have are passed over.
    """
    if isinstance(result, Rejection) or line.reason is not None:
        was, now = line.reason or "trained", getattr(result, "reason", "trained")
        return None if was == now else _differ("the outcome", was, now)
    computed = of_training(result)
    for name in _FIELDS:
        was, now = getattr(line, name), computed[name]
        if was is None or was == now:
            continue
        if isinstance(was, str) or len(was) != len(now):
            return _differ(name, was, now)
        epoch = next(epoch for epoch, pair in enumerate(zip(was, now, strict=True)) if pair[0] != pair[1])
        return _differ(f"{name} of epoch {epoch + 1}", was[epoch], now[epoch])
    return None


def doubts_of(
    made: "RunRecord | StudyRecord | Header",
    numerics: Numerics,
    device: Device,
    packages: Mapping[str, str],
    hardware: Mapping[str, Json],
) -> tuple[str, ...]:
    """Say why this machine is not promised to reproduce the training bits of a run or a study.

    `fast` numerics promise bits on the recorded hardware only, `cuda` on the recorded model of GPU only.
    """
    doubts = deviations({name: made.versions.get(name) for name in _COMPUTING}, packages)
    promised_by = ["cpu", "architecture"] if numerics is Numerics.fast else []
    promised_by += ["gpu"] if device is Device.cuda else []
    return doubts + deviations({name: made.machine.get(name) for name in promised_by}, hardware)


def _check_trivial(run: RecordedRun, trivial: float) -> None:
    """Compare the trivial loss that a run names, if it names one, with that of its data set."""
    if run.record.trivial not in {None, trivial}:
        place = f"{run.path}/run.json, trivial"
        raise DivergenceError(str(run.record.trivial), place=place, expected=f"{trivial}, by the validation labels")


def _differ(what: str, recorded: object, recomputed: object) -> str:
    return f"{what}: recorded {recorded}, recomputed {recomputed}"


def _check_equal(name: str, line: CandidateLine, result: Training | Rejection, doubts: Sequence[str]) -> None:
    """Raise for the first difference, with what explains it beside the candidate."""
    different = difference(line, result)
    if different is None:
        return
    reasons = [f"not promised: {doubt}" for doubt in doubts]
    if isinstance(result, Rejection) and result.reason in BY_MACHINE:
        reasons.append("this depends on the machine's speed and memory; try with executor.workers=1 or a quiet machine")
    if line.not_portable:
        reasons.append(f"the candidate uses {', '.join(line.not_portable)}, whose bits depend on the CPU")
    raise DivergenceError(different, place=f"{name}{line.id}", remedy="; ".join(reasons))
