"""The schema of a config: one dataclass a group, whose annotations are the ranges.

Settings that depend on each other are checked in `tacevo.config.checks`. The layers below the wiring receive values,
never these. An enum's member names are what users write. The reasons for the defaults stand in docs/paper.md. Numbers
without a unit in their name are counts, fractions or temperatures.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

from tacevo.choices import (
    PAPER_AXES,
    AnswerForm,
    BoundsRule,
    Carrier,
    Confinement,
    Device,
    Effort,
    GratingClasses,
    Layout,
    LightScene,
    ModelChoice,
    Normalisation,
    Numerics,
    OperatorScope,
    Precision,
    Scale,
    SplitRule,
    SystemTurn,
    TargetScaling,
    Tell,
    Thinking,
)
from tacevo.errors import ConfigError
from tacevo.parts.facts import HERE, ProviderFacts, SourceFacts, provider_facts, source_facts
from tacevo.records import Delivery, Kind, Loss, Mode, Record
from tacevo.redaction import check_address, names_place
from tacevo.space import Space
from tacevo.typed import UNTYPED, FreeJson


def is_a(words: str, holds: Callable[[Any], object]) -> AfterValidator:
    """Make the rule that a value is what the words say."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise PydanticCustomError("misfit", "Input should be {words}", {"words": words})
        return value

    return AfterValidator(check)


def _is_pattern(text: str) -> bool:
    """Answer whether this is a regular expression that is not empty."""
    try:
        return bool(re.compile(text).pattern)
    except (re.error, OverflowError, RecursionError):
        return False


def _is_thinking(value: Any) -> bool:
    """Answer whether this is a kind of thinking, or a number of tokens for it, or neither is asked for."""
    return value >= 1 if type(value) is int else value in (None, *Thinking)


#: The most of what is looped over or held in memory: a recorded configuration may be anybody's.
MOST = 1_000_000

# The kinds of values; an error names a kind in the words that stand here.
AtLeast0 = Annotated[int, Ge(0)]
AtLeast1 = Annotated[int, Ge(1)]
ZeroToMillion = Annotated[int, Ge(0), Le(MOST)]
OneToMillion = Annotated[int, Ge(1), Le(MOST)]
ImageCount = Annotated[int, Ge(10), Le(10 * MOST)]
Memory = Annotated[int, Ge(64)]
Positive = Annotated[float, Gt(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Share = Annotated[float, Gt(0), Lt(1)]
Text = Annotated[str, is_a("text that is not empty", bool)]
Name = Annotated[str, is_a("letters, digits, _ and -", re.compile(r"[\w-]+").fullmatch)]
#: The name of a part (`tacevo.parts`): one of ours, or of a package's, or of a class that a file defines.
Part = Annotated[str, is_a("the name of a part", re.compile(r"[A-Za-z][\w-]*").fullmatch)]
Identifier = Annotated[str, is_a("a name that Python allows", str.isidentifier)]
#: A number may be written without quotes.
Column = Annotated[Text, BeforeValidator(lambda value: str(value) if type(value) is int else value)]
Pattern = Annotated[str, is_a("a regular expression, in quotes", _is_pattern)]


def _weighed(value: Any) -> Any:
    """Read several models: a list of names, which weigh alike, or a mapping of names to weights."""
    if isinstance(value, Mapping):
        value = list(value.items())
    if not isinstance(value, list | tuple):
        return value
    return tuple((each, 1.0) if isinstance(each, str) else tuple(each) for each in value)


#: The name of a model, which is no place of this machine.
ModelName = Annotated[Text, is_a("a model's name, not a path", lambda value: not names_place(value))]
#: Models with their weights, in the order in which a user names them.
WeighedModels = Annotated[tuple[tuple[ModelName, Positive], ...], BeforeValidator(_weighed)]
#: Choices, each once, in the order of their enum.
Tells = Annotated[tuple[Tell, ...], AfterValidator(lambda value: tuple(each for each in Tell if each in value))]


@dataclass(frozen=True, kw_only=True)
class SearchConfig(Record):
    """The size of a search (paper, Algorithm 1)."""

    generations: ZeroToMillion  #: after generation 0
    #: B, the candidates of a generation.
    candidates: OneToMillion
    #: Mutations of the baseline that start the archive, beside the baseline itself.
    initial: ZeroToMillion
    #: The generation whose trainings bring their sum to so many FLOPs is the last; null for `generations` alone.
    training_flops: Positive | None = None
    #: Generations in a row without one usable answer after which the search stops; null for never.
    stop_after_unusable: AtLeast1 | None = 2
    #: Networks that start the archive beside the baseline in place of its mutations: files, directories and patterns.
    networks: tuple[Text, ...] = ()

    LATER: ClassVar[frozenset[str]] = frozenset({"networks"})


@dataclass(frozen=True, kw_only=True)
class TaskConfig(Record):
    """A task: what a network must do, and the texts that ask for it."""

    name: Name  #: of the task
    kind: Kind  #: regression or classification
    class_name: Identifier  #: what a candidate's class is called
    #: What the baseline's constructor calls the number of outputs.
    output_argument: Identifier
    outputs: OneToMillion  #: how many values or classes
    loss: Loss  #: of training and validation
    #: Names of the regressed values or classes; empty where the data set names them.
    output_names: tuple[str, ...]
    target_scaling: TargetScaling  #: of regressed values
    #: Images that the simulated data set holds: as many as were released, where the paper says how many.
    images: ImageCount
    #: A file below conf/, as the two below: the baseline class.
    baseline: str
    instructions: str  #: what a mutation may be asked
    system: str  #: the system prompt


@dataclass(frozen=True, kw_only=True)
class DataConfig(Record):
    """The source of the images, and how they are prepared."""

    source: Text  #: what holds the images: the name of a part, as `provider`, `kind` of executors and of trackers
    #: Height and width, in pixels.
    image_size: Annotated[int, Ge(16), Le(16_384)]
    #: Simulated: how many. TacVerse: the most that are taken; null for all.
    images: ImageCount | None
    seed: AtLeast0  #: simulated: of the contacts
    sensor_seed: AtLeast0  #: simulated: of the sensor
    light: LightScene  #: simulated: of the sensor
    #: Gratings: the spacings that are the classes, in mm; TacVerse: [] for all.
    spacings_mm: tuple[Positive, ...]
    #: Recorded: the directory of the data set, or the file of a NumPy archive.
    root: str | None
    #: CSV: the table.
    table: str
    image_column: str  #: its column of paths
    target_columns: tuple[str, ...]  #: its columns of labels
    #: Simulated: ViTacTip, ViTac (no markers) or TacTip (opaque). TacVerse: the directories to read, joined by +.
    #: With `sensor_column`: the sensors that are taken, joined by +; * for all.
    sensor: Text
    pattern: Text | None  #: for gratings
    #: Tables: leave out rows whose image is missing, instead of refusing the table.
    skip_missing: bool
    split: SplitRule  #: random, or the release's own
    split_seed: AtLeast0  #: of a random split
    normalisation: Normalisation  #: of the images
    #: With `split=random`: the part of all images that is for validation; what no part takes trains.
    validation_part: Share = 0.1
    test_part: Share = 0.1  #: the part for the test
    #: Recorded: the stored value that becomes 255; null for the largest that the files can hold.
    white_point: Positive | None = None
    #: The column of the table whose value the images of one press share, which a random split keeps in one part.
    group_column: Text | None = None
    group_pattern: Pattern | None = None  #: groups by a regular expression in an image's path
    #: TacVerse: whether `images` and `spacings_mm` select; runs of before this setting took every image and size.
    select: bool = False
    #: TacVerse: what the classes of gratings are.
    classes: GratingClasses = GratingClasses.size
    #: TacVerse, or with `sensor_column`: the sensor that is tested, which then does not train.
    test_sensor: Text | None = None
    #: How much of its training part trains, too: presses of each grating, images of each shape or with forces; with
    #: `sensor_column`, groups of each class, or images where no groups are known.
    shots: AtLeast0 = 0
    #: Simulated: thickness of the clear gel on the sensor's skin.
    gel_mm: Annotated[float, Ge(0), Le(4)] = 0.0
    #: What names the sensor of each image: a column (CSV), an array (NumPy), or a level of directories, from 1.
    sensor_column: Column | None = None
    split_column: Column | None = None  #: what names its part of the split, likewise

    LATER: ClassVar[frozenset[str]] = frozenset({"sensor_column", "split_column"})

    @property
    def facts(self) -> SourceFacts:
        """The facts that are known of the source by its name."""
        return source_facts(self.source)

    @property
    def held_out(self) -> tuple[float, float]:
        """Both parts, as `tacevo.data.splitting` takes them."""
        return self.validation_part, self.test_part


@dataclass(frozen=True, kw_only=True)
class ArchiveConfig(Record):
    """The archives of networks and of prompts; that of prompts is always a CVT archive."""

    niches: OneToMillion  #: of networks
    prompt_niches: OneToMillion  #: of prompts
    #: Uniform points from which k-means finds the centroids.
    samples: OneToMillion
    seed: int  #: of the centroids
    bounds: BoundsRule  #: of the axes: fixed, or as wide as what was trained
    #: With `bounds=fixed`: the (low, high) of a descriptor.
    arch_div_bounds: tuple[float, ...]
    eff_ratio_bounds: tuple[float, ...]  #: of the other descriptor, with `bounds=fixed`
    eff_ratio_scale: Scale  #: of its axis
    kind: Part = "cvt"  #: niches, or the best networks
    #: With `kind=best`: how many networks are kept; niches, axes and bounds then have no effect on networks.
    kept: OneToMillion = 10
    #: The axes of the networks' niches.
    axes: tuple[Part, ...] = PAPER_AXES


#: Stands for a model's name in an estimate of a search whose model is not chosen.
UNCHOSEN = "a model of your choice"


@dataclass(frozen=True, kw_only=True)
class LLMConfig(Record):
    """The model that answers the requests, and how the answers are recorded."""

    provider: Text  #: who answers
    model: str  #: its name; with `models` it may be empty
    mode: Mode  #: record, or replay from the store alone
    max_tokens: AtLeast1  #: of an answer
    #: Another server than the provider's own.
    base_url: str | None
    #: Requests in flight at once.
    concurrency: OneToMillion
    #: Grammar: the part of its answers that carries a fault real models make.
    slip_rate: Fraction
    #: `batch`: a generation as one Message Batch of `llm=anthropic`.
    delivery: Delivery = Delivery.direct
    #: Further sampling settings; what is null or empty is not sent.
    top_p: Annotated[float, Gt(0), Le(1)] | None = None
    top_k: AtLeast1 | None = None  #: null: not sent
    stop_sequences: tuple[Text, ...] = ()  #: []: not sent
    #: An older name of `thinking=N`.
    thinking_tokens: AtLeast1 | None = None
    #: No new request starts that could bring a run's answers above this many US dollars; null for no limit.
    budget_usd: Annotated[float, Ge(0)] | None = None
    #: The price table: a file in the working directory, below conf/, or absolute.
    prices: str = "prices.yaml"
    #: `user` for models without a system prompt: it is joined to the first turn.
    system: SystemTurn = SystemTurn.system
    #: What stands for the model's name in requests, stores, ledger, MLflow and bundles, where that name is a path of
    #: this machine. Only run.json keeps the path, as `llm.model`: the same command continues the run by it.
    label: Annotated[Text, is_a("a name, not a path", lambda value: not names_place(value))] | None = None
    #: Grammar: the closed space in which its answers lie (`llm=grammar_space`); null for the whole grammar.
    space: Space | None = None
    #: The effort that the model puts into an answer; null: not sent.
    effort: Effort | None = None
    #: Whether the model thinks before it answers, or the number of tokens of `max_tokens` for that; null: not sent.
    thinking: Annotated[
        int | str | None, UNTYPED, is_a("adaptive, disabled, a number of tokens of at least 1, or null", _is_thinking)
    ] = None
    #: Several models, of which each slot asks one: [a,b], or with weights {a: 1, b: 3}; null for `llm.model` alone.
    models: WeighedModels | None = None
    choice: ModelChoice = ModelChoice.weights  #: with `models`: by their weights, or a bandit on the children's gain

    LATER: ClassVar[frozenset[str]] = frozenset({"system", "label", "space", "effort", "thinking", "models", "choice"})

    @property
    def facts(self) -> ProviderFacts:
        """The facts that are known of the provider by its name."""
        return provider_facts(self.provider)

    @property
    def thinks(self) -> bool:
        """Whether `thinking` asks the model of a provider of ours to think; then no temperature is sent."""
        return bool(self.facts.host) and self.thinking not in (None, Thinking.disabled)

    @property
    def name(self) -> str:
        """The name of the model in requests and records: its label, if it has one; of several models, all names."""
        return self.label or self.model if self.models is None else ", ".join(self.names)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the models in requests and records, in the order in which the user names them."""
        return (self.label or self.model,) if self.models is None else tuple(name for name, _ in self.models)


@dataclass(frozen=True, kw_only=True)
class TemperatureConfig(Record):
    """The sampling temperature (paper, Algorithm 1, line 9)."""

    rule: Part  #: how it follows the search
    #: T_1, of generation 0.
    start: Fraction
    step: Fraction  #: eta, by which the rule moves it
    jitter: Fraction  #: half the width of the noise around it
    #: What carries it to the model: `parameter`, which many models refuse, `words`, `effort` or `none`.
    carrier: Carrier = Carrier.parameter
    #: With `carrier=effort`: the efforts that it chooses from, rising; the model must take them all.
    efforts: tuple[Effort, ...] = (Effort.low, Effort.medium, Effort.high, Effort.max)

    LATER: ClassVar[frozenset[str]] = frozenset({"carrier", "efforts"})


@dataclass(frozen=True, kw_only=True)
class PromptsConfig(Record):
    """The choice of instructions."""

    policy: Part  #: how an instruction is drawn
    #: The size of the prompt pool P_g, drawn from the library for each generation; null for the whole library.
    pool: OneToMillion | None = None
    #: What a request tells beside parents and instruction: fitness, failures, best, notes; [] for nothing. `shuffled`
    #: is a control for `fitness`, with the figures of other networks.
    tells: Tells = ()
    answer: AnswerForm = AnswerForm.whole  #: whole: the class; edit: search and replace in the (first) parent

    LATER: ClassVar[frozenset[str]] = frozenset({"tells", "answer"})

    def check_library(self, instructions: int) -> None:
        """Refuse a pool that is larger than the task's library of so many instructions."""
        if self.pool is not None and self.pool > instructions:
            expected = f"at most {instructions}, the number of the task's instructions, or null"
            raise ConfigError(str(self.pool), place="prompts.pool", expected=expected)


@dataclass(frozen=True, kw_only=True)
class ProposalsConfig(Record):
    """Operators and parents."""

    #: p_m, the probability that a generation mutates; else it crosses over.
    mutation_probability: Fraction
    parents: Part  #: how parents are drawn
    #: With `parents=best`: how many of the best elites are parents.
    best: OneToMillion
    #: How often an answer that the gate rejected goes back with the reason; the paper discards it.
    repair_attempts: ZeroToMillion = 0
    #: What one draw of the operator holds for; the paper draws one for a whole generation.
    operator_for: OperatorScope = OperatorScope.generation
    #: The part of the candidates that a surrogate, fitted to the search's own trainings, judges worst and skips.
    skipped: Annotated[float, Ge(0), Lt(1)] = 0.0
    #: How many answers each request gets: so many slots in a row share operator, parents, instruction and temperature.
    answers: OneToMillion = 1

    LATER: ClassVar[frozenset[str]] = frozenset({"answers"})


@dataclass(frozen=True, kw_only=True)
class TrainingConfig(Record):
    """The short training behind a fitness."""

    epochs: OneToMillion  #: of a candidate's training
    batch_size: Annotated[int, Ge(2), Le(MOST)]  #: images of a step
    learning_rate: Positive  #: of Adam
    #: The longest time of one candidate's training.
    seconds: Positive
    memory_mib: Memory  #: that one training may use
    device: Device = Device.cpu  #: cpu or cuda
    #: With `device=cuda`: the GPU's model, as `tacevo doctor` names it.
    gpu: Text | None = None
    precision: Precision = Precision.float32  #: with `device=cuda`: of its multiplications
    gpu_memory_mib: Memory = 8192  #: with `device=cuda`: that one training may use
    layout: Layout = Layout.contiguous  #: with `device=cuda`: how images and weights lie in its memory
    #: With `device=cuda`: whether the step of a training is recorded once and replayed, where the network allows it.
    captured: bool = True
    fitness: Part = "last"  #: what a training's fitness is of its validation losses


@dataclass(frozen=True, kw_only=True)
class GateConfig(Record):
    """The limits of an admitted candidate."""

    max_parameters: AtLeast1  #: of a candidate
    max_flops: AtLeast1  #: of one image
    max_modules: AtLeast1  #: of a candidate
    max_source_bytes: AtLeast1  #: of its source
    #: The longest time of one candidate's probe.
    seconds: Positive
    memory_mib: Memory  #: that it may use


@dataclass(frozen=True, kw_only=True)
class SandboxConfig(Record):
    """The confinement of candidates."""

    require: Confinement  #: the least confinement that is accepted


@dataclass(frozen=True, kw_only=True)
class ExecutorConfig(Record):
    """The executor of candidates: where they are evaluated, and how many at once."""

    kind: Text  #: this machine, or Ray
    workers: OneToMillion  #: candidates at once
    #: Ray: the head of the cluster, as HOST:PORT, or `auto` for the one that RAY_ADDRESS names or that runs here; null
    #: to start a Ray of `workers` slots here, which ends with the search.
    address: Text | None = None
    #: With `training.device=cuda`: most candidates that train on one GPU at once; null for as many as fit into its
    #: memory. No result depends on it.
    per_gpu: OneToMillion | None = 1

    @property
    def is_here(self) -> bool:
        """Whether candidates are evaluated on this machine."""
        return self.kind == HERE


@dataclass(frozen=True, kw_only=True)
class NumericsConfig(Record):
    """The promise that training bits keep."""

    kind: Numerics  #: equal bits on every CPU with AVX2, or on equal hardware and faster


@dataclass(frozen=True, kw_only=True)
class TrackingConfig(Record):
    """The mirror of the ledger."""

    kind: Text = "mlflow"  #: mlflow or none
    #: Empty for the one in MLFLOW_TRACKING_URI.
    uri: str = "sqlite:///mlflow.db"
    experiment: str = "tacevo"  #: its name in MLflow

    def __post_init__(self) -> None:
        """Reject a password, which the run directory would record."""
        check_address(self.uri, "tracking.uri")


@dataclass(frozen=True, kw_only=True)
class StoreConfig(Record):
    """The store in which answers are recorded."""

    root: Text  #: the directory of the stores


@dataclass(frozen=True, kw_only=True)
class OutputConfig(Record):
    """The directory of a run; None names one after the task, the seed and the configuration."""

    dir: Text | None = None  #: the directory of the run; null for one in runs/


@dataclass(frozen=True, kw_only=True)
class PartCode(Record):
    """The code of a part that a user brought, on which the results of a run depend, beside its settings."""

    #: The kind of the part (`tacevo.parts.kinds`).
    kind: Literal["parents", "prompts", "temperatures", "archives", "descriptors", "fitness"]
    #: The place of its class: the dotted name of its module, and its own.
    module: Annotated[str, is_a("a module's name", re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*").fullmatch)]
    attribute: Identifier
    #: The digest of its sources (`tacevo.config.recorded_parts.code_hash`).
    sha256: Annotated[str, is_a("64 hex digits", re.compile(r"[0-9a-f]{64}").fullmatch)]
    #: The constants of its class that others look at.
    constants: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RunConfig(Record):
    """One whole run."""

    seed: AtLeast0
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
    run: OutputConfig = OutputConfig()
    #: Settings of parts that a user brought, by the name of the part.
    parts: Mapping[str, Mapping[str, FreeJson]] = field(default_factory=dict)
    #: The code of the parts among them that decide results, as composing found it.
    code: Mapping[str, PartCode] = field(default_factory=dict)

    LATER: ClassVar[frozenset[str]] = frozenset({"parts", "code"})

    def own_settings(self, name: str) -> Mapping[str, FreeJson]:
        """Return the settings of a part's own, which no other part has: of `FILE.py:CLASS`, under the class's name."""
        return self.parts.get(name.rpartition(":")[2], {})


def keys(schema: type = RunConfig, prefix: str = "") -> list[str]:
    """List every key of a schema, e.g. `archive.niches`."""
    names = []
    for each in fields(schema):
        names.append(f"{prefix}{each.name}")
        if isinstance(each.type, type) and is_dataclass(each.type):
            names += keys(each.type, f"{prefix}{each.name}.")
    return names
