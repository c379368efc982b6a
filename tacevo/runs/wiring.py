"""The wiring of a search from its configuration: the place that builds objects and joins them (models: `providers`)."""

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn, Self

from tacevo.choices import AnswerForm, BoundsRule, Confinement, Device, Numerics
from tacevo.config.checks import check_device
from tacevo.config.chosen import part_of
from tacevo.config.schema import ArchiveConfig, NumericsConfig, RunConfig, TrainingConfig
from tacevo.data.dataset import Dataset
from tacevo.errors import CacheMissError, SandboxError, StoreError
from tacevo.evolution.archive import AxisBounds, Cvt, NetworkArchive, Tessellation, TopK, find_centroids
from tacevo.evolution.descriptors import on_axis
from tacevo.evolution.development import LLM, Effects
from tacevo.evolution.proposals import Settings, Telling
from tacevo.evolution.state import Budget, Plan, Skipping
from tacevo.evolution.told import Told
from tacevo.gate.admission import DataImages, Gate, GateLimits
from tacevo.parts.executor import Executor, Notice, Order
from tacevo.parts.kinds import EXECUTORS
from tacevo.profile import Admitted
from tacevo.records import DataFacts, Gpu, Json, Limits, Mode, Recipe, Rejection, Task
from tacevo.rules import CONTIGUOUS, CURRENT, EAGER, MKL_FUNCTIONS, STUDY, TRAININGS_OF_STUDIES, Rules
from tacevo.runs.datasets import answering, examples_of, held_out_of
from tacevo.runs.decisions import Parts
from tacevo.runs.providers import build_llm, provider_settings
from tacevo.runs.seeds import training_seed
from tacevo.sandbox.client import Died, Finished, RunJob, Score
from tacevo.sandbox.devices import DEVICES
from tacevo.storage.array_store import KIND, ArrayStore
from tacevo.storage.store import Store, Stores
from tacevo.training import evaluation
from tacevo.training.evaluation import Evaluator, Setting
from tacevo.training.full import FullEvaluator
from tacevo.training.memory import predicted_mib
from tacevo.training.numerics import environment
from tacevo.training.weights import Weighed, train_and_weigh
from tacevo.typed import convert

#: The functions that a sandbox runs, by entry name.
ENTRIES = {"probe": "tacevo.gate.probe:run", **evaluation.ENTRIES}


def build_plan(
    config: RunConfig,
    task: Task,
    facts: DataFacts,
    mode: Mode,
    *,
    parts: Parts,
    stores: Stores | None = None,
) -> Plan:
    """Turn a configuration into the plan of a search; the centroids come from `stores`, or from the configured ones."""
    archive = config.archive
    store = (stores or stores_of(config)).of("centroids", mode)
    bounds = _fixed_bounds(archive, parts)
    return Plan(
        task=task,
        settings=build_settings(config, parts),
        generations=config.search.generations,
        initial=config.search.initial,
        networks=_places(archive, parts, store),
        prompts=_tessellation(archive, archive.prompt_niches, 2, store),
        archive=NetworkArchive(bounds=bounds, fixed=bounds is not None),
        axes=parts.axes(),
        temperature=parts.temperature(),
        temperature_start=config.temperature.start,
        repairs=config.proposals.repair_attempts,
        given_by="search.networks" if config.search.networks else "networks",
        skipping=skipping_of(config),
        budget=_budget(config, facts),
        fitness=parts.fitness(),
    )


def skipping_of(config: RunConfig) -> Skipping | None:
    """Return what decides which candidates are not trained, where the configuration asks for it."""
    part = config.proposals.skipped
    if not part:
        return None
    from tacevo.evolution.surrogate import SkipsWorst  # a room of its own, which may be missing

    return SkipsWorst(part=part)


def _budget(config: RunConfig, facts: DataFacts) -> Budget | None:
    """Return the bound on a search's trainings, where the configuration has one."""
    flops = config.search.training_flops
    if flops is None:
        return None
    train, _, _ = facts.counts
    return Budget(flops=flops, images=train, epochs=config.training.epochs)


def build_settings(config: RunConfig, parts: Parts) -> Settings:
    """Turn a configuration into the settings of its proposals."""
    return Settings(
        seed=config.seed,
        candidates=config.search.candidates,
        mutation_probability=config.proposals.mutation_probability,
        parents=parts.parents(),
        prompts=parts.prompts(),
        jitter=config.temperature.jitter,
        model=config.llm.name,
        max_tokens=config.llm.max_tokens,
        llm=provider_settings(config.llm, config.own_settings(config.llm.provider)),
        carrier=config.temperature.carrier,
        efforts=config.temperature.efforts,
        system=config.llm.system,
        operator_for=config.proposals.operator_for,
        answers=config.proposals.answers,
        pool=config.prompts.pool,
        telling=_telling(config),
        models=config.llm.models or (),
        choice=config.llm.choice,
    )


def _telling(config: RunConfig) -> Telling | None:
    """Return what requests tell, and how they are answered; None where the configuration has nothing of that."""
    tells, edits = config.prompts.tells, config.prompts.answer is AnswerForm.edit
    return Told(tells=tells, edits=edits) if tells or edits else None


def _fixed_bounds(archive: ArchiveConfig, parts: Parts) -> AxisBounds | None:
    """Return the bounds of the network archive's axes, where the configuration has them."""
    if not parts.archive().has_niches or archive.bounds is BoundsRule.adaptive:
        return None
    scale = archive.eff_ratio_scale
    ranges = [[on_axis(axis, end, scale) for end in getattr(archive, f"{axis}_bounds")] for axis in archive.axes]
    low, high = zip(*ranges, strict=True)
    return AxisBounds(low=low, high=high)


def stores_of(config: RunConfig) -> Stores:
    """Return the stores that a configuration names."""
    return Stores(Path(config.store.root))


def _places(archive: ArchiveConfig, parts: Parts, store: Store) -> Tessellation | TopK:
    """Return the network archive's niches, or the places of one that has none."""
    part = parts.archive()
    if not part.has_niches:
        return TopK(niches=archive.kept)
    if isinstance(part, Cvt):
        return _tessellation(archive, archive.niches, len(archive.axes), store)
    return Tessellation(part.centroids(archive.niches, len(archive.axes)))


def _tessellation(archive: ArchiveConfig, niches: int, dimensions: int, store: Store) -> Tessellation:
    shape = {"niches": niches, "dimensions": dimensions, "samples": archive.samples, "seed": archive.seed}
    recalled = store.recall(shape, lambda: find_centroids(**shape))
    centroids = convert(list[list[float]], recalled, place="centroids", error=StoreError)
    if [len(centroid) for centroid in centroids] != [dimensions] * niches:
        expected = f"{niches} points of {dimensions} coordinates"
        raise StoreError(f"{len(centroids)} others", place=str(store.path(store.key(shape))), expected=expected)
    return Tessellation(centroids)


def started_ahead(config: RunConfig) -> AbstractContextManager[Any]:
    """Start what the executor needs and what takes seconds, in which the search can load its data and plan.

    It yields the `started` of a `Workbench`: None where there is nothing to start.
    """
    if answering(config).run is not None:
        return contextlib.nullcontext()
    return _executor(config).ahead(order_of(config))


def check_means(config: RunConfig) -> None:
    """Check, before anything is made, that candidates can run as a configuration asks; a node is checked when it joins.

    Raises:
        SandboxError: they cannot be confined so here.
        ConfigError: this machine cannot compute so, or device, numerics, walls and executor do not go together; or Ray
            is asked for and not installed, or not at its address; or evaluations are looked up, and as `table_of`.
    """
    if answering(config).run is not None:
        return  # nothing runs
    check_device(config)
    _executor(config).check(order_of(config))


def _executor(config: RunConfig) -> Executor:
    """Return what runs candidates."""
    executor: Executor = part_of(config, EXECUTORS)
    return executor


@dataclass(eq=False)
class Workbench:
    """The gate, the trainings and the model of a run, over one sandbox or cluster and the threads that wait for it.

    That is made when a gate or an evaluator first needs it. A replay needs none, so it works on a machine without one.
    """

    config: RunConfig
    task: Task
    facts: DataFacts
    #: The mode of the stores; the completions follow `llm.mode`, unless this is `replay`.
    mode: Mode
    _: KW_ONLY
    #: The data set; None where nothing is trained, as in a replay.
    data: Dataset | None = None
    #: The stores; None for those that the configuration names.
    stores: Stores | None = None
    #: Called with what confines a candidate, as `in_force` describes it, before its answer is kept.
    notice: Notice | None = None
    #: Called with a line for the user.
    say: Callable[[str], None] | None = None
    #: Called after each epoch that is scored on this machine, in the thread that waits for the training.
    on_epoch: Callable[[], None] | None = None
    #: The function that runs jobs: the executor's, unless another one is given.
    run: RunJob | None = None
    #: The value of `started_ahead`.
    started: Any = None
    #: The LLM of `build_llm`, in this mode; built where it is needed if there is none.
    llm: LLM | None = None
    _stack: contextlib.ExitStack = field(init=False, default_factory=contextlib.ExitStack)

    def __post_init__(self) -> None:
        #: The threads that wait for the sandbox.
        self.executor = ThreadPoolExecutor(self.config.executor.workers, "worker")
        self._waited = threading.local()

    def __enter__(self) -> Self:
        self._stack.enter_context(self.executor)
        self._stack.callback(self.executor.shutdown, wait=False, cancel_futures=True)
        return self

    def __exit__(self, *_: object) -> None:
        """End the candidates first, and then the threads that wait for them."""
        self._stack.close()

    def effects(self, rules: Rules) -> Effects:
        """Return the effects of a search."""
        gate, evaluator = self.gate(rules), self.evaluator(rules)
        seed, mode = training_seed(self.config.seed, 0), self._mode_under(rules)
        llm = self.llm if mode is self.mode else None
        return Effects(
            llm=llm or build_llm(self.config, mode, stores=self.stores),
            admit=gate.admit,
            inspect=gate.inspect,
            measure=gate.measure,
            evaluate=lambda source: evaluator.evaluate(source, seed),
            evaluation_key=lambda source: evaluator.key(source, seed),
            executor=self.executor,
            cpu_seconds=self.cpu_seconds,
            edited=gate.edited,
        )

    def gate(self, rules: Rules) -> Gate:
        """Return the gate of the task."""
        gate, mode, images = self.config.gate, self._mode_under(rules), self._probed_images()
        is_known = images is not None or mode is Mode.replay or self.config.data.facts.is_looked_up
        return Gate(
            run=self._sandbox(mode),
            answers=self._store("answers", mode),
            store=self._store("probes", mode),
            contract=self.task.contract,
            # A probe that saw no image is kept under no data set.
            fingerprint=self.facts.fingerprint if is_known else None,
            images=images,
            limits=GateLimits(
                parameters=gate.max_parameters,
                flops=gate.max_flops,
                modules=gate.max_modules,
            ),
            source_bytes=gate.max_source_bytes,
            probe_limits=Limits(seconds=gate.seconds, memory_mib=gate.memory_mib),
            numerics=self.config.numerics.kind,
            rules=rules,
        )

    def _probed_images(self) -> DataImages | None:
        """Return the images of the data set that a probe shows; None where none is at hand."""
        if self.data is None or self.config.data.facts.is_looked_up:
            return None
        examples = examples_of(self.data)
        return DataImages.of(examples.train, examples.mean, examples.deviation)

    def evaluator(self, rules: Rules) -> Evaluator:
        """Return what trains candidates as a search under these rules does; under older ones it stores nothing."""
        store, setting = self._store("evaluations", self._mode_under(rules)), self._setting(rules.training)
        examples = None if self.data is None else examples_of(self.data)
        kind = Evaluator if examples is None else answering(self.config).evaluator
        return kind(run=self._sandbox(self.mode), store=store, setting=setting, examples=examples, rules=rules.training)

    def studies(self, rules: int, scale: Sequence[float], *, predictions: bool = True) -> FullEvaluator:
        """Return what trains and tests networks fully, under the rules of that number; under older ones none is stored.

        `scale` is that of the labels, in units of the recording for one unit of training; empty of a classification.
        Without `predictions`, the stores have none.
        """
        mode = self.mode if rules == STUDY else Mode.replay
        return FullEvaluator(
            run=self._sandbox(self.mode),
            store=self._store("studies", mode),
            setting=self._setting(TRAININGS_OF_STUDIES.get(rules, CURRENT.training)),
            examples=None if self.data is None else (examples_of(self.data), held_out_of(self.data)),
            rules=rules,
            arrays=ArrayStore(self._store(KIND, mode)) if predictions else None,
            facts=self.facts,
            scale=scale,
        )

    def weigh(self, source: str, seed: int, epoch: int, training: int) -> Weighed | Rejection:
        """Train a network under these rules of training, and keep its weights after an epoch; nothing is stored."""
        assert self.data is not None  # as whoever trains must have it
        setting = self._setting(training)
        data = examples_of(self.data), held_out_of(self.data)
        return train_and_weigh(self._sandbox(self.mode), setting, source, seed, epoch=epoch, data=data)

    def _mode_under(self, rules: Rules) -> Mode:
        """Keep what this code computes from being stored under the numbers of other rules."""
        return self.mode if rules == CURRENT else Mode.replay

    def cpu_seconds(self) -> float:
        """Return the processor time of all candidates that this thread has waited for."""
        return getattr(self._waited, "seconds", 0.0)

    def _sandbox(self, mode: Mode) -> RunJob:
        """Return what runs jobs and notes their processor time; in a replay, stores answer all of them."""
        if mode is Mode.replay:
            return _refuse_to_run
        run = self._runner()

        def noting(
            entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
        ) -> Finished | Died:
            outcome = run(entry, header, payload, limits, self._told(score))
            self._waited.seconds = self.cpu_seconds() + outcome.cpu_seconds
            return outcome

        return noting

    def _told(self, score: Score | None) -> Score | None:
        """Return a score that also tells of each epoch; on a cluster, where it is computed elsewhere, it tells none."""
        told = self.on_epoch
        if score is None or told is None or not self.config.executor.is_here:
            return score

        def telling_score(number: int, payload: bytes) -> float:
            told()
            return score(number, payload)

        return telling_score

    def _runner(self) -> RunJob:
        if self.run is None:
            self.run = answering(self.config).run
        if self.run is None:
            opened = _executor(self.config).open(
                order_of(self.config),
                None if self.data is None else self.data.images,
                started=self.started,
                notice=self.notice,
                say=self.say,
                predict=self._predicted,
            )
            self.run = self._stack.enter_context(opened)
        return self.run

    def _predicted(self, header: Mapping[str, Any]) -> int | None:
        """Predict the memory that a training takes of a GPU, in MiB, where the probe of its network is recorded."""
        gate = replace(self.gate(CURRENT), run=_refuse_to_run, store=self._store("probes", Mode.replay))
        with contextlib.suppress(CacheMissError):
            probed = gate.measure(header["source"])
            if isinstance(probed, Admitted):
                images, recipe = header["train"] + header["validation"], Recipe.from_json(header["recipe"])
                return predicted_mib(probed.profile, self.task.contract, recipe, images)
        return None

    def _store(self, kind: str, mode: Mode) -> Store:
        return (self.stores or stores_of(self.config)).of(kind, mode)

    def _setting(self, training: int) -> Setting:
        """Return the setting of trainings under the rules of that number."""
        return Setting(
            contract=self.task.contract,
            fingerprint=self.facts.fingerprint,
            recipe=recipe_under(self.config, training),
            numerics=self.config.numerics.kind,
            device=self.config.training.device,
            contiguous=training in CONTIGUOUS,
            mkl_functions=training in MKL_FUNCTIONS,
        )


def order_of(config: RunConfig) -> Order:
    """Return what a sandbox must do, here or on a node."""
    device = config.training.device
    return Order(
        entries=ENTRIES if device is Device.cpu else {**ENTRIES, **evaluation.ENTRIES_OF_GPUS},
        equip=None if device is Device.cpu else evaluation.EQUIP,
        environment=environment(config.numerics.kind, device),
        doors=() if device is Device.cpu or config.sandbox.require is not Confinement.kernel else DEVICES,
        numerics=config.numerics.kind,
        device=device,
        gpu=config.training.gpu,
        per_gpu=config.executor.per_gpu,
        require=config.sandbox.require,
    )


def _refuse_to_run(entry: str, *_: object) -> NoReturn:
    raise SandboxError(
        f"a job for a sandbox ({entry})", expected="a replay that runs no candidate", remedy="record the run again"
    )


def trained_by(config: RunConfig, recipe: Recipe, numerics: Numerics, device: Device) -> RunConfig:
    """Return a configuration with the training of a recipe, on a device and with its numerics; see `recipe_of`."""
    gpu, unset = recipe.gpu, TrainingConfig
    training = replace(
        config.training,
        epochs=recipe.epochs,
        seconds=recipe.limits.seconds,
        memory_mib=recipe.limits.memory_mib,
        device=device,
        gpu=gpu.model if gpu else None,
        precision=gpu.precision if gpu else unset.precision,
        gpu_memory_mib=gpu.memory_mib if gpu else unset.gpu_memory_mib,
        layout=gpu.layout if gpu else unset.layout,
        captured=gpu.captured if gpu else unset.captured,
    )
    return replace(config, training=training, numerics=NumericsConfig(kind=numerics))


def recipe_under(config: RunConfig, training: int) -> Recipe:
    """Turn the training of a configuration into the recipe that it has under the rules of that number."""
    recipe = recipe_of(config)
    if recipe.gpu is None or training not in EAGER:
        return recipe
    return replace(recipe, gpu=replace(recipe.gpu, captured=False))


def recipe_of(config: RunConfig) -> Recipe:
    """Turn the training of a configuration into a recipe."""
    training, gpu = config.training, None
    if training.gpu is not None:
        gpu = Gpu(
            model=training.gpu,
            precision=training.precision,
            memory_mib=training.gpu_memory_mib,
            layout=training.layout,
            captured=training.captured,
        )
    return Recipe(
        epochs=training.epochs,
        batch_size=training.batch_size,
        learning_rate=training.learning_rate,
        optimiser="adam",
        limits=Limits(seconds=training.seconds, memory_mib=training.memory_mib),
        gpu=gpu,
    )
