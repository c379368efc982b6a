"""The frozen values that the layers hand to each other; this module knows none of them.

Every record is immutable and compares by value. Those that enter a file go through `to_json` or `written`, and come
back through `tacevo.typed`. The sandbox's child, which has no pydantic, reads by `from_json`.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar, overload

from tacevo.choices import Layout, Precision

T = TypeVar("T")

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

#: The values that `json` writes.
Json = None | bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"]

#: The value of `__pydantic_config__` for a record that is read from outside (`tacevo.typed`): nothing is guessed or
#: dropped.
STRICT = {"strict": True, "extra": "forbid", "allow_inf_nan": False}

#: A provider's setting: a number, a word, or several words.
Setting = float | str | tuple[str, ...]


class Record:
    """A frozen dataclass that `tacevo.typed` reads, strictly."""

    __slots__ = ()
    __pydantic_config__ = STRICT

    #: Fields that came later: `to_json` leaves them out at their defaults, as files of earlier versions do.
    LATER: ClassVar[frozenset[str]] = frozenset()


class Kind(StrEnum):
    """The kind of a task, by what it asks of a network. Member names are what users write in a config."""

    regression = "regression"
    classification = "classification"


class Loss(StrEnum):
    """The task loss: mean squared error over all axes, or cross-entropy in nats."""

    mse = "mse"
    cross_entropy = "cross_entropy"


class Mode(StrEnum):
    """The use of a store: `live` never reads, `record` reads or else computes and writes, `replay` only reads."""

    live = "live"
    record = "record"
    replay = "replay"


class Delivery(StrEnum):
    """The delivery of requests: `direct` one by one, or a generation as one `batch`, slower and cheaper."""

    direct = "direct"
    batch = "batch"


class Operator(StrEnum):
    """The operator by which a candidate was asked for."""

    baseline = "baseline"
    #: A network of the user's, which no model was asked for.
    given = "given"
    mutation = "mutation"
    crossover = "crossover"
    #: Drawn at random, without a parent.
    sample = "sample"


class Stage(StrEnum):
    """The stage at which a candidate was rejected, in the order of the gate; the last is training."""

    extract = "extract"
    policy = "policy"
    probe = "probe"
    train = "train"


class Reason(StrEnum):
    """The reason for which a candidate was rejected; it enters the ledger, free text does not."""

    # extract: from the model's answer to source text
    empty = "empty"
    invalid_request = "invalid_request"
    refused = "refused"
    truncated = "truncated"
    too_long = "too_long"
    no_class = "no_class"
    ambiguous = "ambiguous"
    syntax = "syntax"
    #: The edits of an answer cannot be applied to the parent.
    misfit_edit = "misfit_edit"
    # policy: what the syntax tree shows
    forbidden_import = "forbidden_import"
    forbidden_name = "forbidden_name"
    forbidden_construct = "forbidden_construct"
    too_complex = "too_complex"
    # policy and probe: what makes a candidate misreport itself
    redefines_module = "redefines_module"
    changes_its_weights = "changes_its_weights"
    changes_its_mode = "changes_its_mode"
    hidden_parameters = "hidden_parameters"
    depends_on_batch = "depends_on_batch"
    #: The candidate takes steps, or runs backward passes, of its own.
    learns_by_itself = "learns_by_itself"
    # probe and train: what happens when it runs
    construction_failed = "construction_failed"
    forward_failed = "forward_failed"
    backward_failed = "backward_failed"
    bad_output = "bad_output"
    not_finite = "not_finite"
    no_gradient = "no_gradient"
    nondeterministic = "nondeterministic"
    #: The candidate draws in evaluation mode, such as a dropout that is always on.
    random_in_evaluation = "random_in_evaluation"
    #: The candidate draws its initial weights from a seed of its own.
    fixed_seed = "fixed_seed"
    too_many_parameters = "too_many_parameters"
    too_many_flops = "too_many_flops"
    too_many_modules = "too_many_modules"
    out_of_time = "out_of_time"
    out_of_memory = "out_of_memory"
    too_much_output = "too_much_output"
    crashed = "crashed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection(Record):
    """A candidate's failure: a value, never an exception."""

    stage: Stage
    reason: Reason
    #: One line for a person, with what was expected and what came. Not in the ledger; but a repair quotes it to the
    #: model, which makes it part of that request's key.
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ChatMessage(Record):
    """One turn of a conversation; `role` is `user` or `assistant`."""

    role: str
    content: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Request(Record):
    """Everything that can change a completion, and nothing else."""

    model: str
    system: str
    messages: tuple[ChatMessage, ...]
    #: Sampling temperature in [0, 1]; None where none is sent, because words, effort or nothing carry T
    #: (`tacevo.choices.Carrier`).
    temperature: float | None
    max_tokens: int
    #: The number of this draw of an otherwise equal request, so that equal prompts give distinct answers.
    draw: int
    #: Further settings of the provider, by name, in the order of their names.
    settings: tuple[tuple[str, Setting], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LongPrompts(Record):
    """The price of all tokens of a request, in US dollars for a million, where its prompt is long."""

    #: A prompt is long if it has more tokens than this.
    above_tokens: int
    input_usd: float
    output_usd: float

    def __post_init__(self) -> None:
        """Raise ValueError where a number is below 0."""
        if min(self.above_tokens, self.input_usd, self.output_usd) < 0:
            raise ValueError("numbers of at least 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Price(Record):
    """The price of a model's tokens when it was asked."""

    #: US dollars for a million tokens.
    input_usd: float
    output_usd: float
    #: The day of the price table, as `YYYY-MM-DD`.
    dated: str
    #: The factor by which the delivery multiplies both, e.g. 0.5 for a batch.
    factor: float = 1.0
    #: US dollars for a million input tokens that the provider read from its cache, and that it wrote there; None where
    #: an answer has no such tokens, or their price is not known.
    cache_read_usd: float | None = None
    cache_write_usd: float | None = None
    #: The price of a request with a long prompt; None where the length does not matter, as of every answer.
    long: LongPrompts | None = None

    LATER: ClassVar[frozenset[str]] = frozenset({"cache_read_usd", "cache_write_usd", "long"})

    def of_prompt(self, tokens: float) -> Price:
        """Return the price of a request whose prompt has so many tokens."""
        if self.long is None or tokens <= self.long.above_tokens:
            return dataclasses.replace(self, long=None)
        read, written = self.long.input_usd, self.long.output_usd
        return dataclasses.replace(self, input_usd=read, output_usd=written, long=None)

    def cost(self, input_tokens: float, output_tokens: float) -> float:
        """Return what these tokens cost, in US dollars, none of them from a cache, and no prompt being long."""
        return self.factor * (self.input_usd * input_tokens + self.output_usd * output_tokens) / 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Completion(Record):
    """The answer of a model; recordings of earlier versions lack the fields from `dropped` on."""

    text: str
    #: The model's name as the provider returned it.
    model: str
    #: `end_turn`, `max_tokens` (cut off) or `refusal`, as in Anthropic's Messages API; `unknown` for a word that nobody
    #: knows; `invalid_request` where the provider refuses the request itself, e.g. because it is too long;
    #: `key_repeated` where the text repeated the API key and is not recorded.
    stop_reason: str
    #: The number of input tokens as the server counted them, those of its cache included; None where it did not
    #: (recordings of earlier versions hold what it said instead, `true` say: see `tokens`).
    input_tokens: bool | int | None
    output_tokens: bool | int | None
    #: Sampling settings of the request that the model refuses, and that were therefore not sent.
    dropped: tuple[str, ...] = ()
    delivery: Delivery = Delivery.direct
    #: The price of the answer's tokens; None where the price table does not know the model.
    price: Price | None = None
    #: The number of input tokens that the provider read from its cache, and of those that it wrote there; None where it
    #: said something else than a number.
    cache_read: int | None = 0
    cache_written: int | None = 0
    #: Whether another server than the provider's own answered, and gave the model's name.
    elsewhere: bool = False

    LATER: ClassVar[frozenset[str]] = frozenset({"cache_read", "cache_written", "elsewhere"})

    @property
    def tokens(self) -> tuple[int, int] | None:
        """Input and output tokens; None where one of them is not known."""
        read, written = token_count(self.input_tokens), token_count(self.output_tokens)
        return None if read is None or written is None else (read, written)

    @property
    def cost(self) -> float | None:
        """The cost of the answer, in US dollars; None where its tokens or their price are not known."""
        price, tokens, read, written = self.price, self.tokens, self.cache_read, self.cache_written
        if price is None or tokens is None or read is None or written is None:
            return None
        usd = price.cost(tokens[0] - read - written, tokens[1])
        for cached, each in ((read, price.cache_read_usd), (written, price.cache_write_usd)):
            if cached and each is None:
                return None
            usd += price.factor * cached * (each or 0.0) / 1_000_000
        return usd

    def content(self) -> dict[str, Json]:
        """Return what the model said, for the ledger: without delivery and price."""
        said = ("text", "model", "stop_reason", "input_tokens", "output_tokens")
        return {name: getattr(self, name) for name in said}


def token_count(value: object) -> int | None:
    """Read a number of tokens; None for all that is none: `true`, a text, a fraction, less than 0, more than 10^9."""
    return value if type(value) is int and 0 <= value <= 10**9 else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Contract(Record):
    """The contract of a candidate class: the part of a task that the gate and the trainer enforce.

    The class is built as `Class(in_channels=..., <output_argument>=...)`, each argument only where its
    constructor has one of that name. It maps float32 `(N, in_channels, image_size, image_size)` to float32
    `(N, outputs)`.
    """

    class_name: str
    kind: Kind
    loss: Loss
    in_channels: int
    #: Height and width of an image, in pixels.
    image_size: int
    #: Number of regressed values, or of classes.
    outputs: int
    #: The name of the number of outputs in the baseline's constructor, e.g. `num_classes`.
    output_argument: str

    @property
    def offered(self) -> dict[str, int]:
        """The arguments that a constructor may have."""
        return {"in_channels": self.in_channels, self.output_argument: self.outputs}

    def arguments(self, made: Callable[..., object]) -> dict[str, int]:
        """Return those of the arguments that a candidate's constructor has."""
        parameters = inspect.signature(made).parameters
        return {name: value for name, value in self.offered.items() if name in parameters}

    def construct(self, made: Callable[..., T]) -> T:
        """Call a candidate's class with those of its arguments that its constructor has."""
        return made(**self.arguments(made))

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """Read what `to_json` wrote."""
        return cls(**{**value, "kind": Kind(value["kind"]), "loss": Loss(value["loss"])})


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruction(Record):
    """One entry of a prompt library."""

    id: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Given(Record):
    """A network that stands in generation 0 because a user gave it."""

    #: Different from `baseline` and from all others.
    name: str
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Task(Record):
    """A task as data: its contract and the texts that ask for networks."""

    name: str
    contract: Contract
    #: Source of the baseline class a0.
    baseline: str
    #: The filled-in system prompt.
    system: str
    #: The prompt library, in order; a prompt index points into it.
    instructions: tuple[Instruction, ...]
    #: The fixed instruction of every crossover.
    crossover: str
    #: The networks that generation 0 holds beside the baseline, in place of mutations of it; empty where it holds
    #: those.
    given: tuple[Given, ...] = ()
    #: The sentences that carry a temperature in words, from the least departure to the boldest; empty where words do
    #: not carry it.
    boldness: tuple[str, ...] = ()

    LATER: ClassVar[frozenset[str]] = frozenset({"boldness"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits(Record):
    """The limits of a candidate; over one it is killed or rejected with a typed reason."""

    #: Wall time of the whole child process, in seconds.
    seconds: float
    #: Peak resident memory of the child's process tree beyond what it shares with its parent, in MiB.
    memory_mib: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Gpu(Record):
    """The GPU that a candidate trains on: all that decides its bits, or where its memory ends."""

    #: The model as CUDA names it, e.g. `NVIDIA H200`.
    model: str
    precision: Precision
    #: The most memory of the GPU that a training may have, with its images, in MiB.
    memory_mib: int
    layout: Layout = Layout.contiguous
    #: Whether a step is recorded once and replayed, where the network allows it; never before number 5 of the rules.
    captured: bool = False

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """Read what `to_json` or `written` wrote."""
        precision, layout = Precision(value["precision"]), Layout(value.get("layout", Layout.contiguous))
        return cls(**{**value, "precision": precision, "layout": layout})


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe(Record):
    """The recipe by which a candidate is trained; part of an evaluation's key."""

    epochs: int
    batch_size: int
    learning_rate: float
    #: The only optimiser so far.
    optimiser: Literal["adam"]
    limits: Limits
    #: The GPU of the training; None on a CPU.
    gpu: Gpu | None = None

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Self:
        """Read what `to_json` or `written` wrote."""
        gpu = value.get("gpu")
        return cls(**{**value, "limits": Limits(**value["limits"]), "gpu": None if gpu is None else Gpu.from_json(gpu)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Training(Record):
    """The results of a finished training; its fitness is `tacevo.parts.Fitness.of` its validation losses."""

    #: Mean training loss of each epoch, as the child reported it; shown, never used for selection.
    train_losses: tuple[float, ...]
    #: Validation loss after each epoch, computed by the parent from the child's predictions.
    validation_losses: tuple[float, ...]
    #: SHA-256 of the validation predictions of every epoch, float32, row-major.
    predictions_sha256: str
    #: SHA-256 of the trained weights and buffers, as the child reported it.
    weights_sha256: str
    #: Operations that ran although torch has no deterministic form of them on the device, in order, as the child
    #: reported them; on a CPU such a candidate is rejected instead.
    not_deterministic: tuple[str, ...] = ()
    #: Whether its steps were recorded once and replayed, where that was asked for; None elsewhere.
    captured: bool | None = None

    LATER: ClassVar[frozenset[str]] = frozenset({"captured"})


@dataclass(frozen=True, slots=True, kw_only=True)
class DataFacts(Record):
    """The facts of its data set that a run records, so that it can be replayed without it."""

    #: SHA-256 over images, labels, split, label scaling and input statistics.
    fingerprint: str
    #: The kind of task that its labels are for.
    kind: Kind
    #: Images in the training, validation and test split.
    counts: tuple[int, int, int]
    in_channels: int
    image_size: int
    #: Regressed values, or classes.
    outputs: int
    #: Names of the regressed values or of the classes, in the order of the outputs.
    names: tuple[str, ...]
    #: The settings that selected images of a recording, e.g. `data.images=700`; none where all were taken.
    selected: tuple[str, ...] = ()
    #: The groups of test images that were recorded together: the number of each image's group, in the order of the test
    #: rows. Groups are numbered from 0 as they come. Empty where none are known, as in runs of earlier releases.
    groups: tuple[int, ...] = ()

    LATER: ClassVar[frozenset[str]] = frozenset({"selected", "groups"})

    def __post_init__(self) -> None:
        """Raise ValueError where the groups are not those of the test images."""
        known = 0
        for number in self.groups:
            if not 0 <= number <= known:
                raise ValueError("groups that are numbered from 0 in the order in which they come")
            known = max(known, number + 1)
        if self.groups and len(self.groups) != self.counts[2]:
            raise ValueError(f"a group for each of the {self.counts[2]} test images, or none")

    @property
    def units(self) -> int:
        """The number of independent test units: the groups of images where these are known, or else the images."""
        return len(set(self.groups)) or self.counts[2]

    @property
    def is_grouped(self) -> bool:
        """Whether test images share groups."""
        return self.units < self.counts[2]

    def as_said_by(self, record: DataFacts) -> DataFacts:
        """Return these facts without what came later and a record, which may be of an earlier release, does not say."""
        silent: dict[str, Any] = {name: () for name in self.LATER if not getattr(record, name)}
        return dataclasses.replace(self, **silent)


@overload
def to_json(record: DataclassInstance) -> dict[str, Json]: ...
@overload
def to_json(record: object) -> Json: ...
def to_json(record: Any) -> Any:
    """Turn a record (or a tuple, mapping or scalar of such) into plain JSON values.

    Enums become their values and tuples become lists; NaN and infinity stay, for the writer to refuse. A field that
    came later (`Record.LATER`) is left out at its default.
    """
    if type(record) in _SCALARS:  # most values; what follows takes ten times as long
        return record
    if fields := _fields(record.__class__):
        values = {field.name: to_json(getattr(record, field.name)) for field in fields}
        for field in _later(record.__class__):
            if getattr(record, field.name) == default_of(field):
                del values[field.name]
        return values
    if isinstance(record, StrEnum):
        return record.value
    if isinstance(record, Mapping):
        return {str(key): to_json(value) for key, value in record.items()}
    if isinstance(record, Sequence) and not isinstance(record, str):
        return [to_json(value) for value in record]
    return record


def written(record: Any) -> dict[str, Json]:
    """Turn a record into JSON as `to_json` does, without the fields that are at their defaults; `kind` always stays.

    So a field that came later leaves the bytes of older records as they are.
    """
    values = {field.name: (getattr(record, field.name), default_of(field)) for field in dataclasses.fields(record)}
    return {name: _written(value) for name, (value, default) in values.items() if name == "kind" or value != default}


def default_of(field: dataclasses.Field[Any]) -> Any:
    """Return the value of a field that is not given; `MISSING` of one that must be."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _written(value: Any) -> Json:
    if _fields(value.__class__):
        return written(value)
    return [_written(part) for part in value] if isinstance(value, tuple) else to_json(value)


_SCALARS = frozenset({str, int, float, bool, type(None)})


@cache
def _fields(kind: Any) -> tuple[dataclasses.Field[Any], ...]:
    """Return the fields of a dataclass; none of another type."""
    return dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()


@cache
def _later(kind: Any) -> tuple[dataclasses.Field[Any], ...]:
    """Return the fields of a dataclass that came later."""
    return tuple(field for field in _fields(kind) if field.name in getattr(kind, "LATER", ()))
