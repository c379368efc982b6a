"""From a configuration to a running search: the place that builds objects and joins them (models: `providers`)."""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

from tacevo.choices import ArchiveKind, Axis, BoundsRule, Confinement, Device, ExecutorKind
from tacevo.config.schema import ArchiveConfig, ExecutorConfig, RunConfig
from tacevo.data.dataset import Dataset
from tacevo.gate.admission import Gate, GateLimits
from tacevo.randomness import derived_seed
from tacevo.records import Contract, DataFacts, Limits, Mode, Recipe, Task
from tacevo.rules import CURRENT, STUDY, Rules
from tacevo.runs.providers import build_llm, provider_settings
from tacevo.runs.standins import InPlace, refuse_to_run
from tacevo.sandbox.client import Notice, Run, Sandbox
from tacevo.search.algorithm import Plan
from tacevo.search.archive import Bounds, NetworkArchive, Places, Tessellation, find_centroids
from tacevo.search.descriptors import scaled
from tacevo.search.development import Evaluate, Tools
from tacevo.search.proposals import Settings
from tacevo.storage.store import Seen, Store
from tacevo.training import evaluation
from tacevo.training.evaluation import Evaluator, Examples, Setting
from tacevo.training.full import FullEvaluator, HeldOut
from tacevo.training.numerics import environment

#: What a sandbox runs: entry names to functions.
ENTRIES = {"probe": "tacevo.gate.probe:run", **evaluation.ENTRIES}


def build_plan(config: RunConfig, task: Task, mode: Mode, *, seen: Seen | None = None) -> Plan:
    """Turn a configuration into the plan of a search; the centroids come from the store, which tells `seen`."""
    archive = config.archive
    bounds = _fixed_bounds(archive)
    return Plan(
        task=task,
        settings=build_settings(config),
        generations=config.search.generations,
        initial=config.search.initial,
        networks=_places(config, mode, seen),
        prompts=_tessellation(config, archive.prompt_niches, 2, mode, seen),
        archive=NetworkArchive(bounds=bounds, fixed=bounds is not None),
        eff_ratio_scale=archive.eff_ratio_scale,
        temperature_rule=config.temperature.rule,
        temperature_start=config.temperature.start,
        temperature_step=config.temperature.step,
        repairs=config.proposals.repair_attempts,
        axes=tuple(archive.axes),
    )


def build_settings(config: RunConfig) -> Settings:
    """Turn a configuration into the settings of its proposals."""
    return Settings(
        seed=config.seed,
        candidates=config.search.candidates,
        mutation_probability=config.proposals.mutation_probability,
        parents=config.proposals.parents,
        best=config.proposals.best,
        prompts=config.prompts.policy,
        jitter=config.temperature.jitter,
        model=config.llm.model,
        max_tokens=config.llm.max_tokens,
        llm=provider_settings(config.llm),
        operator_for=config.proposals.operator_for,
        pool=config.prompts.pool,
    )


def _fixed_bounds(archive: ArchiveConfig) -> Bounds | None:
    """Give the bounds of the network archive's axes, where the configuration has them."""
    if archive.kind is ArchiveKind.best or archive.bounds is BoundsRule.adaptive:
        return None
    scale = archive.eff_ratio_scale
    ranges = {
        Axis.arch_div: archive.arch_div_bounds,
        Axis.eff_ratio: [scaled(value, scale) for value in archive.eff_ratio_bounds],
    }
    low, high = zip(*(ranges[axis] for axis in archive.axes), strict=True)
    return Bounds(low=low, high=high)


def _places(config: RunConfig, mode: Mode, seen: Seen | None) -> Tessellation | Places:
    """Give the network archive's niches, or the places of one that has none."""
    archive = config.archive
    match archive.kind:
        case ArchiveKind.cvt:
            return _tessellation(config, archive.niches, len(archive.axes), mode, seen)
        case ArchiveKind.best:
            return Places(niches=archive.kept)


def _tessellation(config: RunConfig, niches: int, dimensions: int, mode: Mode, seen: Seen | None) -> Tessellation:
    shape = {"niches": niches, "dimensions": dimensions, "samples": config.archive.samples, "seed": config.archive.seed}
    return Tessellation(_store(config, "centroids", mode, seen).recall(shape, lambda: find_centroids(**shape)))


@contextlib.contextmanager
def open_tools(
    config: RunConfig,
    task: Task,
    facts: DataFacts,
    data: Dataset | None,
    mode: Mode,
    *,
    rules: Rules,
    seen: Seen | None = None,
    notice: Notice | None = None,
) -> Iterator[Tools]:
    """Open the effects of a search: model, gate, training, workers.

    Args:
        config: the run's configuration.
        task: the task.
        facts: of the data set.
        data: the data set; None where every answer is recorded, as in a replay.
        mode: of the probes, evaluations and centroids; the completions follow `llm.mode`, unless this is `replay`.
        rules: to search under; with others than the current ones, every store only replays.
        seen: told of every store entry that is read.
        notice: told of what holds each candidate, before its answer is kept.
    """
    examples, mode = None if data is None else _examples(data), _mode_under(rules, mode)
    with _workers(config, data, mode, notice) as (run, executor):
        fingerprint = facts.fingerprint
        yield build_tools(
            config, task, fingerprint, run, rules, executor=executor, examples=examples, mode=mode, seen=seen
        )


def build_tools(
    config: RunConfig,
    task: Task,
    fingerprint: str,
    run: Run,
    rules: Rules,
    *,
    executor: Executor,
    examples: Examples | None,
    mode: Mode,
    seen: Seen | None = None,
) -> Tools:
    """Build the effects of a search over a sandbox that is open.

    Args:
        config: the run's configuration.
        task: the task.
        fingerprint: of the data set.
        run: what runs a job in the sandbox.
        rules: as in `open_tools`.
        executor: the threads that wait for it.
        examples: to train on; None where every answer is recorded.
        mode: as in `open_tools`; `replay` with other rules than the current ones.
        seen: told of every store entry that is read.
    """
    gate = build_gate(config, task.contract, run, mode, rules, seen=seen)
    evaluator = Evaluator(
        run=run,
        store=_store(config, "evaluations", mode, seen),
        setting=_setting(config, task, fingerprint),
        examples=examples,
        rules=rules.training,
    )
    seed = derived_seed(config.seed, "training")
    return Tools(
        llm=build_llm(config, mode, seen=seen),
        admit=gate.admit,
        inspect=gate.inspect,
        evaluate=lambda source: evaluator.evaluate(source, seed),
        evaluation_key=lambda source: evaluator.key(source, seed),
        executor=executor,
    )


@contextlib.contextmanager
def open_trainer(config: RunConfig, task: Task, data: Dataset) -> Iterator[tuple[Evaluate, Executor]]:
    """Open what trains candidates as a run does, but neither reads nor writes the store of evaluations.

    Args:
        config: the run's configuration.
        task: the task.
        data: the data set.
    """
    with _workers(config, data, Mode.live) as (run, executor):
        store = _store(config, "evaluations", Mode.live, seen=None)
        setting = _setting(config, task, data.facts.fingerprint)
        evaluator = Evaluator(run=run, store=store, setting=setting, examples=_examples(data), rules=CURRENT.training)
        seed = derived_seed(config.seed, "training")
        yield lambda source: evaluator.retrain(source, seed), executor


@contextlib.contextmanager
def open_studies(
    config: RunConfig,
    task: Task,
    facts: DataFacts,
    data: Dataset | None,
    mode: Mode,
    *,
    rules: int,
    seen: Seen | None = None,
) -> Iterator[tuple[FullEvaluator, Executor]]:
    """Open what trains networks fully and tests them.

    Args:
        config: the run's configuration, with the training of the study.
        task: the task.
        facts: of the data set.
        data: the data set; None where every training is recorded.
        mode: of the store.
        rules: number of the full trainings; with another than the current one, the store only replays.
        seen: told of every store entry that is read.
    """
    if rules != STUDY:
        mode = Mode.replay
    with _workers(config, data, mode) as (run, executor):
        setting = _setting(config, task, facts.fingerprint)
        store = _store(config, "studies", mode, seen)
        examples = None if data is None else (_examples(data), _held_out(data))
        yield FullEvaluator(run=run, store=store, setting=setting, examples=examples, rules=rules), executor


@contextlib.contextmanager
def open_gate(config: RunConfig, contract: Contract, mode: Mode) -> Iterator[tuple[Callable[[Rules], Gate], Executor]]:
    """Open the gate of a task alone, under any rules, with the threads of its run; a process starts with a probe."""
    with _workers(config, None, mode) as (run, executor):
        yield lambda rules: build_gate(config, contract, run, mode, rules), executor


@contextlib.contextmanager
def _workers(
    config: RunConfig, data: Dataset | None, mode: Mode, notice: Notice | None = None
) -> Iterator[tuple[Run, Executor]]:
    """Open the sandbox and the threads that wait for it; a replay has neither, so it works without a sandbox."""
    if mode is Mode.replay:
        yield refuse_to_run, InPlace()
        return
    arrays = {} if data is None else {"images": data.images}
    with contextlib.ExitStack() as stack:
        executor = stack.enter_context(_executor(config.executor))
        stack.callback(executor.shutdown, wait=False, cancel_futures=True)
        # Entered last and so closed first: an interrupted search ends its candidates, and then its threads.
        device = config.training.device
        sandbox = stack.enter_context(
            Sandbox(
                entries=ENTRIES,
                environment=environment(config.numerics.kind, device),
                arrays=arrays,
                strongest=Confinement.kernel if device is Device.cpu else Confinement.none,
                notice=notice,
            )
        )
        yield sandbox.run, executor


def _setting(config: RunConfig, task: Task, fingerprint: str) -> Setting:
    return Setting(
        contract=task.contract,
        fingerprint=fingerprint,
        recipe=recipe_of(config),
        numerics=config.numerics.kind,
        device=config.training.device,
    )


def _executor(executor: ExecutorConfig) -> Executor:
    match executor.kind:
        case ExecutorKind.local:
            return ThreadPoolExecutor(executor.workers, "worker")


def build_gate(
    config: RunConfig, contract: Contract, run: Run, mode: Mode, rules: Rules, *, seen: Seen | None = None
) -> Gate:
    """Build the gate of a task; with other rules than the current ones, its stores only replay."""
    gate, mode = config.gate, _mode_under(rules, mode)
    return Gate(
        run=run,
        answers=_store(config, "answers", mode, seen),
        store=_store(config, "probes", mode, seen),
        contract=contract,
        limits=GateLimits(
            parameters=gate.max_parameters,
            flops=gate.max_flops,
            modules=gate.max_modules,
            source_bytes=gate.max_source_bytes,
        ),
        probe_limits=Limits(seconds=gate.seconds, memory_mib=gate.memory_mib),
        numerics=config.numerics.kind,
        rules=rules,
    )


def _mode_under(rules: Rules, mode: Mode) -> Mode:
    """Keep what this code computes from being stored under the numbers of other rules."""
    return mode if rules == CURRENT else Mode.replay


def recipe_of(config: RunConfig) -> Recipe:
    """Turn the training of a configuration into a recipe."""
    training = config.training
    return Recipe(
        epochs=training.epochs,
        batch_size=training.batch_size,
        learning_rate=training.learning_rate,
        optimiser="adam",
        limits=Limits(seconds=training.seconds, memory_mib=training.memory_mib),
    )


def _examples(data: Dataset) -> Examples:
    return Examples(
        train=data.train,
        validation=data.validation,
        train_targets=data.targets[data.train],
        validation_targets=data.targets[data.validation],
        mean=data.mean,
        deviation=data.deviation,
        fingerprint=data.facts.fingerprint,
    )


def _held_out(data: Dataset) -> HeldOut:
    return HeldOut(rows=data.test, targets=data.targets[data.test], names=data.facts.names, scale=data.scale)


def _store(config: RunConfig, kind: str, mode: Mode, seen: Seen | None) -> Store:
    return Store(Path(config.store.root), kind, mode, seen=seen)
