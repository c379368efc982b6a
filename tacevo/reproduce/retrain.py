"""`tacevo replay RUN --retrain [N]`: recorded evaluations computed again and held against their records, bit by bit.

Nothing is read from the store of evaluations and nothing is written to it. The weights' digest is computed in the
confined process, so it is that process's claim, then as now; losses of validation and digest of predictions are not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from tacevo.choices import Device, Numerics
from tacevo.config.recorded import read_run
from tacevo.environment import deviations, machine, versions
from tacevo.errors import DivergenceError
from tacevo.randomness import derived_seed, stream
from tacevo.records import Json, Mode, Reason, Rejection, Training
from tacevo.rules import CURRENT, TRAININGS, by_rules, check_known
from tacevo.runs.datasets import load_same
from tacevo.runs.progress import Progress
from tacevo.runs.wiring import Workbench
from tacevo.sandbox.confinement import require
from tacevo.storage.run_directory import RunDirectory
from tacevo.training.numerics import check_machine

#: Fields of a ledger line that hold a training's numbers, in the order in which they are compared.
_FIELDS = ("train_losses", "validation_losses", "predictions", "weights")

#: Why a training may end on one machine and not on another.
_BY_MACHINE = {Reason.out_of_time, Reason.out_of_memory}

#: Packages whose version may change training bits.
_COMPUTING = ("torch", "numpy")

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Retrained:
    """Evaluations that were found to be as recorded."""

    #: How many of those computed again are trainings, whose bits were compared.
    trained: int
    #: How many are rejections, whose reasons were compared.
    rejected: int
    #: How many evaluations the run has.
    of: int
    #: Fields that the run does not record.
    not_recorded: tuple[str, ...]
    #: Why equal bits were not promised; empty where they were.
    doubts: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Chosen:
    """What of one run is trained again."""

    run: Path
    #: Ledger lines of evaluations.
    lines: tuple[Mapping[str, Json], ...]


def retrain(runs: Sequence[Path], store: str | None, count: int | None, view: Progress) -> Retrained:
    """Train candidates of finished runs again, and compare every bit that the runs recorded of them.

    An evaluation that several runs share counts once.

    Args:
        runs: the run directories, one or a sweep's; their ledgers must have been checked.
        store: where the stores lie, if not where the runs had them; of these the images are used.
        count: how many evaluations to draw from those of all runs, with the first run's seed; None for all of them.
        view: who is told.

    Raises:
        DivergenceError: the first difference.
        DataError: a run's data set is not there, or is another one.
        ConfigError: this machine cannot compute what a run's numerics ask for.
        RunError: a candidate's source is missing or was edited, run.json is damaged, or this release's trainer cannot
            train as the run's did.
    """
    pairs = _evaluations(runs)
    seed = read_run(RunDirectory(runs[0]))[0].seed
    drawn = sampled(pairs, count, seed)
    chosen = [_Chosen(run=run, lines=tuple(line for of, line in drawn if of == run)) for run in runs]
    doubts: dict[str, None] = {}
    for part in chosen:
        if part.lines:
            name = f"{part.run.name} " if len(runs) > 1 else ""
            doubts |= dict.fromkeys(_retrain(part, store, view, name))
    lines = [line for part in chosen for line in part.lines]
    trained = [line for line in lines if "stage" not in line]
    return Retrained(
        trained=len(trained),
        rejected=len(lines) - len(trained),
        of=len(pairs),
        not_recorded=tuple(name for name in _FIELDS if any(name not in line for line in trained)),
        doubts=tuple(doubts),
    )


def _evaluations(runs: Sequence[Path]) -> list[tuple[Path, Mapping[str, Json]]]:
    """List the evaluations of all runs, each with the first run that has it."""
    found: dict[str, tuple[Path, Mapping[str, Json]]] = {}
    for run in runs:
        directory = RunDirectory(run)
        ledger = directory.read_ledger()
        with directory.believed():
            numbers = {line["hash"]: rules.training for rules, line in by_rules(ledger)}
        for line in evaluated(ledger):
            found.setdefault(line["evaluation"], (run, line))
            check_known("training", numbers[line["hash"]], TRAININGS, run)
    return list(found.values())


def _retrain(chosen: _Chosen, store: str | None, view: Progress, name: str) -> tuple[str, ...]:
    """Train candidates of one run again and compare; say why equal bits were not promised.

    Args:
        chosen: the candidates, one or more.
        store: see `retrain`.
        view: who is told.
        name: what stands before a candidate's id; empty where there is one run only.
    """
    directory = RunDirectory(chosen.run)
    config, task, facts = read_run(directory, store)
    require(config.sandbox.require)
    check_machine(config.numerics.kind, config.training.device)
    with directory.believed():
        doubts = doubts_of(directory.read_run(), config.numerics.kind, config.training.device, versions(), machine())
    for doubt in doubts:
        view.say(f"equal bits are not promised: {doubt}")
    sources = [directory.read_source(line["id"], line["source"]) for line in chosen.lines]
    data = load_same(config, facts, view)
    seed = derived_seed(config.seed, "training")
    with Workbench(config, task, data.facts, Mode.live, data=data) as bench:
        retrained = bench.executor.map(partial(bench.evaluator(CURRENT).retrain, seed=seed), sources)
        results = zip(chosen.lines, retrained, strict=True)
        for number, (line, result) in enumerate(results, start=1):
            _insist_on_equal(name, line, result, doubts)
            view.say(f"{name}{line['id']}: as recorded ({number} of {len(chosen.lines)})")
    return doubts


def describe(found: Retrained) -> str:
    """Say what was compared, for a person."""
    recorded = [name for name in _FIELDS if name not in found.not_recorded]
    lines = [f"retrained: {found.trained + found.rejected} of {found.of} evaluations"]
    if found.trained and recorded:
        lines.append(f"trained: {found.trained}; {', '.join(recorded)} are bit for bit as recorded")
    if found.rejected:
        lines.append(f"rejected: {found.rejected}, for the recorded reasons")
    if found.not_recorded:
        lines.append(f"not recorded, hence not compared: {', '.join(found.not_recorded)}")
    return "\n".join(lines)


def evaluated(ledger: Sequence[Mapping[str, Json]]) -> list[Mapping[str, Json]]:
    """Give the first line of every evaluation whose outcome does not hang on the machine's speed or memory."""
    lines: dict[str, Mapping[str, Json]] = {}
    for line in ledger:
        if "evaluation" in line and line.get("reason") not in _BY_MACHINE:
            lines.setdefault(line["evaluation"], line)
    return list(lines.values())


def sampled(lines: Sequence[T], count: int | None, seed: int) -> list[T]:
    """Draw lines without repetition, in their order; all of them where `count` is None or not below their number."""
    if count is None or count >= len(lines):
        return list(lines)
    places = stream(seed, "retrain").choice(len(lines), count, replace=False)
    return [lines[place] for place in sorted(places.tolist())]


def difference(line: Mapping[str, Json], result: Training | Rejection) -> str | None:
    """Name the first field in which a recomputed evaluation differs from its ledger line, with both values.

    Fields that the line does not have are passed over.
    """
    recorded, recomputed = _outcome(line.get("reason")), _outcome(getattr(result, "reason", None))
    if isinstance(result, Rejection) or "reason" in line:
        return None if recorded == recomputed else _differ("the outcome", recorded, recomputed)
    fields = (result.train_losses, result.validation_losses, result.predictions_sha256, result.weights_sha256)
    for name, value in zip(_FIELDS, fields, strict=True):
        if name in line and isinstance(value, tuple):
            if len(line[name]) != len(value):
                return _differ(f"the number of {name}", len(line[name]), len(value))
            for epoch, (was, now) in enumerate(zip(line[name], value, strict=True), start=1):
                if was != now:
                    return _differ(f"{name} of epoch {epoch}", was, now)
        elif name in line and line[name] != value:
            return _differ(name, line[name], value)
    return None


def doubts_of(
    run: Mapping[str, Json],
    numerics: Numerics,
    device: Device,
    packages: Mapping[str, str],
    hardware: Mapping[str, Json],
) -> tuple[str, ...]:
    """Say why a run's training bits are not promised to come again here.

    Args:
        run: what run.json holds.
        numerics: of the run; `fast` promises bits on the recorded hardware only.
        device: of the run; `cuda` promises them on the recorded model of GPU only.
        packages: versions of this environment, as `versions` gives them.
        hardware: this machine, as `machine` describes it.
    """
    doubts = deviations({name: run["versions"][name] for name in _COMPUTING}, packages)
    promised_by = ["cpu", "architecture"] if numerics is Numerics.fast else []
    promised_by += ["gpu"] if device is Device.cuda else []
    return doubts + deviations({name: run["machine"][name] for name in promised_by}, hardware)


def _outcome(reason: Json) -> str:
    return "trained" if reason is None else str(reason)


def _differ(what: str, recorded: object, recomputed: object) -> str:
    return f"{what}: recorded {recorded}, recomputed {recomputed}"


def _insist_on_equal(name: str, line: Mapping[str, Json], result: Training | Rejection, doubts: Sequence[str]) -> None:
    """Raise for the first difference, with what explains it beside the candidate."""
    found = difference(line, result)
    if found is None:
        return
    reasons = [f"not promised: {doubt}" for doubt in doubts]
    if isinstance(result, Rejection) and result.reason in _BY_MACHINE:
        reasons.append("this depends on the machine's speed and memory; try with executor.workers=1 or a quiet machine")
    if "not_portable" in line:
        reasons.append(f"the candidate uses {', '.join(line['not_portable'])}, whose bits depend on the CPU")
    raise DivergenceError("; ".join([f"{name}{line['id']} differs in {found}", *reasons]))
