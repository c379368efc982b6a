"""What a user may write in a config: one dataclass a group, checked as soon as it is built.

Plain dataclasses, because Hydra cannot merge into frozen ones; they go no further than the wiring, and the
layers below receive values. An enum's member names are what users write. The reasons for the defaults stand in
docs/paper.md. Numbers without a unit in their name are counts, fractions or temperatures.
"""

import math
import re
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from tacevo.choices import (
    OPTIONAL_SAMPLING,
    Confinement,
    Device,
    ExecutorKind,
    Numerics,
    OperatorScope,
    ParentPolicy,
    PromptPolicy,
    Provider,
    TargetScaling,
    TemperatureRule,
    Tracking,
)
from tacevo.config.archive import ArchiveConfig
from tacevo.config.checks import is_positive, require
from tacevo.config.data import DataConfig
from tacevo.records import Delivery, Kind, Loss, Mode
from tacevo.redaction import check_address


def _is_address(value: str) -> bool:
    """Say whether a server can be reached by this, and a path be put behind it."""
    if not value.isprintable() or set(value) & set(" ?#"):
        return False
    try:
        parts = urlsplit(value)
        return parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:  # half an IPv6 address, or a port that is none
        return False


@dataclass(kw_only=True)
class SearchConfig:
    """The size of a search (paper, Algorithm 1)."""

    generations: int
    #: B, the candidates of a generation.
    candidates: int
    #: Mutations of the baseline that start the archive, beside the baseline itself.
    initial: int

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(self.generations >= 0, "search.generations", "a value >= 0", self.generations)
        require(self.candidates >= 1, "search.candidates", "a value >= 1", self.candidates)
        require(self.initial >= 0, "search.initial", "a value >= 0", self.initial)


@dataclass(kw_only=True)
class TaskConfig:
    """A task: what a network must do, and the texts that ask for it."""

    name: str
    kind: Kind
    class_name: str
    #: What the baseline's constructor calls the number of outputs.
    output_argument: str
    outputs: int
    loss: Loss
    #: Names of the regressed values or classes; empty where the data set names them.
    output_names: list[str]
    target_scaling: TargetScaling
    #: Images that the simulated data set holds: as many as were released, where the paper says how many.
    images: int
    #: Files below conf/: the baseline class, the instructions, the system prompt.
    baseline: str
    instructions: str
    system: str

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(re.fullmatch(r"[\w-]+", self.name) is not None, "task.name", "letters, digits, _ and -", self.name)
        require(self.class_name.isidentifier(), "task.class_name", "a Python class name", self.class_name)
        argument = self.output_argument
        require(argument.isidentifier(), "task.output_argument", "a Python argument name", argument)
        least = 2 if self.kind is Kind.classification else 1
        require(self.outputs >= least, "task.outputs", f"a value >= {least} for {self.kind}", self.outputs)
        suits = (self.loss is Loss.cross_entropy) == (self.kind is Kind.classification)
        require(suits, "task.loss", "mse for regression, cross_entropy for classification", self.loss.value)
        require(self.images >= 10, "task.images", "a value >= 10", self.images)


def deliveries(provider: Provider) -> tuple[Delivery, ...]:
    """Give the deliveries that a provider has."""
    return tuple(Delivery) if provider is Provider.anthropic else (Delivery.direct,)


@dataclass(kw_only=True)
class LLMConfig:
    """Who answers the requests, and how the answers are recorded."""

    provider: Provider
    model: str
    mode: Mode
    max_tokens: int
    #: Another server than the provider's own.
    base_url: str | None
    #: Requests in flight at once.
    concurrency: int
    #: Grammar: the part of its answers that carries a fault real models make.
    slip_rate: float
    #: `batch`: a generation as one Message Batch of `llm=anthropic`.
    delivery: Delivery = Delivery.direct
    #: Further sampling settings; what is null or empty is not sent.
    top_p: float | None = None
    top_k: int | None = None
    stop_sequences: list[str] = field(default_factory=list)
    #: Tokens of `max_tokens` that the model may think with before it answers.
    thinking_tokens: int | None = None
    #: No new request starts that could bring a run's answers above this many US dollars; null for no limit.
    budget_usd: float | None = None
    #: The price table: a file below conf/, or absolute.
    prices: str = "prices.yaml"

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(bool(self.model), "llm.model", "a model name", self.model)
        require(self.max_tokens >= 1, "llm.max_tokens", "a value >= 1", self.max_tokens)
        sound = self.base_url is None or _is_address(self.base_url)
        told = (self.base_url or "").rpartition("@")[2]  # a message holds no login
        require(sound, "llm.base_url", "an address such as http://localhost:8000/v1 (no ?, no #), or null", told)
        require(self.concurrency >= 1, "llm.concurrency", "a value >= 1", self.concurrency)
        require(0 <= self.slip_rate <= 1, "llm.slip_rate", "a value in [0, 1]", self.slip_rate)
        self._check_sampling()
        delivered = self.delivery in deliveries(self.provider)
        require(delivered, "llm.delivery", f"direct for llm={self.provider}", self.delivery.value)
        sound = self.budget_usd is None or 0 <= self.budget_usd < math.inf
        require(sound, "llm.budget_usd", "a finite value >= 0, or null", self.budget_usd)
        kept = self.budget_usd is None or self.mode is not Mode.live
        require(
            kept, "llm.budget_usd", "null with llm.mode=live, where each command pays for all anew", self.budget_usd
        )

    def _check_sampling(self) -> None:
        for key, providers in OPTIONAL_SAMPLING.items():
            value = getattr(self, key)
            known = self.provider in providers or not value
            require(known, f"llm.{key}", f"to be left out for llm={self.provider}, which does not know it", value)
        top_p, top_k, thinking = self.top_p, self.top_k, self.thinking_tokens
        require(top_p is None or 0 < top_p <= 1, "llm.top_p", "a value in (0, 1], or null", top_p)
        require(top_k is None or top_k >= 1, "llm.top_k", "a value >= 1, or null", top_k)
        require(all(self.stop_sequences), "llm.stop_sequences", "texts that are not empty", self.stop_sequences)
        fits = thinking is None or 1 <= thinking < self.max_tokens
        require(fits, "llm.thinking_tokens", f"a value from 1 to below llm.max_tokens={self.max_tokens}", thinking)


@dataclass(kw_only=True)
class TemperatureConfig:
    """The sampling temperature (paper, Algorithm 1, line 9)."""

    rule: TemperatureRule
    #: T_1, eta, and the half-width of the uniform noise eps.
    start: float
    step: float
    jitter: float

    def __post_init__(self) -> None:
        """Check the ranges."""
        for key in ("start", "step", "jitter"):
            value = getattr(self, key)
            require(0 <= value <= 1, f"temperature.{key}", "a value in [0, 1]", value)


@dataclass(kw_only=True)
class PromptsConfig:
    """How instructions are chosen."""

    policy: PromptPolicy
    #: The size of the prompt pool P_g, drawn from the library for each generation; null for the whole library.
    pool: int | None = None

    def __post_init__(self) -> None:
        """Check the ranges; `check_library` checks the rest, once the task is read."""
        require(self.pool is None or self.pool >= 1, "prompts.pool", "a value >= 1, or null", self.pool)

    def check_library(self, instructions: int) -> None:
        """Refuse a pool that is larger than the task's library of so many instructions."""
        fits = self.pool is None or self.pool <= instructions
        require(fits, "prompts.pool", f"a value from 1 to the task's {instructions} instructions, or null", self.pool)


@dataclass(kw_only=True)
class ProposalsConfig:
    """Operators and parents."""

    #: p_m, the probability that a generation mutates; else it crosses over.
    mutation_probability: float
    parents: ParentPolicy
    #: With `parents=best`: how many of the best elites are parents.
    best: int
    #: How often an answer that the gate turned away goes back with the reason; the paper discards it.
    repair_attempts: int = 0
    #: What one draw of the operator holds for; the paper draws one for a whole generation.
    operator_for: OperatorScope = OperatorScope.generation

    def __post_init__(self) -> None:
        """Check the ranges."""
        p_m = self.mutation_probability
        require(0 <= p_m <= 1, "proposals.mutation_probability", "a value in [0, 1]", p_m)
        crosses = self.parents is not ParentPolicy.baseline or p_m == 1
        require(
            crosses,
            "proposals.mutation_probability",
            "1 with proposals.parents=baseline, which has nobody to cross with",
            p_m,
        )
        drawn = self.operator_for is OperatorScope.generation or 0 < p_m < 1
        require(drawn, "proposals.operator_for", f"generation with mutation_probability={p_m:g}", "candidate")
        require(self.best >= 1, "proposals.best", "a value >= 1", self.best)
        require(self.repair_attempts >= 0, "proposals.repair_attempts", "a value >= 0", self.repair_attempts)


@dataclass(kw_only=True)
class TrainingConfig:
    """The short training behind a fitness."""

    epochs: int
    batch_size: int
    learning_rate: float
    #: What one candidate's training may use.
    seconds: float
    memory_mib: int
    device: Device = Device.cpu

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(self.epochs >= 1, "training.epochs", "a value >= 1", self.epochs)
        require(self.batch_size >= 2, "training.batch_size", "a value >= 2", self.batch_size)
        require(is_positive(self.learning_rate), "training.learning_rate", "a finite value > 0", self.learning_rate)
        require(is_positive(self.seconds), "training.seconds", "a finite value > 0", self.seconds)
        require(self.memory_mib >= 64, "training.memory_mib", "a value >= 64", self.memory_mib)


@dataclass(kw_only=True)
class GateConfig:
    """What an admitted candidate may be."""

    max_parameters: int
    max_flops: int
    max_modules: int
    max_source_bytes: int
    #: What one candidate's probe may use.
    seconds: float
    memory_mib: int

    def __post_init__(self) -> None:
        """Check the ranges."""
        for key in ("max_parameters", "max_flops", "max_modules", "max_source_bytes"):
            require(getattr(self, key) >= 1, f"gate.{key}", "a value >= 1", getattr(self, key))
        require(is_positive(self.seconds), "gate.seconds", "a finite value > 0", self.seconds)
        require(self.memory_mib >= 64, "gate.memory_mib", "a value >= 64", self.memory_mib)


@dataclass(kw_only=True)
class SandboxConfig:
    """How candidates are confined."""

    require: Confinement


@dataclass(kw_only=True)
class ExecutorConfig:
    """Where candidates are evaluated, and how many at once."""

    kind: ExecutorKind
    workers: int

    def __post_init__(self) -> None:
        """Check the ranges."""
        require(self.workers >= 1, "executor.workers", "a value >= 1", self.workers)


@dataclass(kw_only=True)
class NumericsConfig:
    """Which promise training bits keep."""

    kind: Numerics


@dataclass(kw_only=True)
class TrackingConfig:
    """The mirror of the ledger."""

    kind: Tracking
    #: Empty for the one in MLFLOW_TRACKING_URI.
    uri: str
    experiment: str

    def __post_init__(self) -> None:
        """Reject a password, which the run directory would record."""
        check_address(self.uri, "tracking.uri")


@dataclass(kw_only=True)
class StoreConfig:
    """Where answers are recorded."""

    root: str

    def __post_init__(self) -> None:
        """Refuse an empty name, which would scatter the stores over the current folder."""
        require(bool(self.root), "store.root", "the name of a folder", self.root)


@dataclass(kw_only=True)
class OutputConfig:
    """Where a run is written; None names a folder after the task, the seed and the configuration."""

    dir: str | None = None

    def __post_init__(self) -> None:
        """Refuse an empty name, which would scatter a run over the current folder."""
        require(self.dir != "", "run.dir", "the name of a folder, or null", self.dir)


@dataclass(kw_only=True)
class RunConfig:
    """One whole run."""

    seed: int
    search: SearchConfig
    task: TaskConfig
    data: DataConfig
    llm: LLMConfig
    archive: ArchiveConfig
    temperature: TemperatureConfig
    prompts: PromptsConfig
    proposals: ProposalsConfig
    training: TrainingConfig
    gate: GateConfig
    sandbox: SandboxConfig
    executor: ExecutorConfig
    numerics: NumericsConfig
    tracking: TrackingConfig
    store: StoreConfig
    run: OutputConfig = field(default_factory=OutputConfig)

    def __post_init__(self) -> None:
        """Check what spans several groups."""
        require(self.seed >= 0, "seed", "a value >= 0", self.seed)
        if self.training.device is Device.cuda:
            walls, numerics = self.sandbox.require, self.numerics.kind
            none = walls is Confinement.none
            require(none, "sandbox.require", "none with training.device=cuda: no driver works behind the walls", walls)
            fast = numerics is Numerics.fast
            require(fast, "numerics.kind", "fast with training.device=cuda, whose bits hold on one GPU only", numerics)
