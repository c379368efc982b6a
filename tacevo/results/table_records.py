"""The records of the table of a space: its header, its rows, and both as `tacevo.results.space_table` reads them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, MinLen

from tacevo.config.plain import from_plain
from tacevo.config.schema import RunConfig
from tacevo.profile import Profile
from tacevo.records import DataFacts, Record, Rejection, Task
from tacevo.results.study import LOSS
from tacevo.rules import Rules
from tacevo.text import counted
from tacevo.training.full import FullTraining
from tacevo.typed import FreeJson

NETWORKS, TRAININGS, CARD, MANIFEST = (
    "networks.jsonl",
    "trainings.jsonl",
    "README.md",
    "manifest.sha256",
)

#: Before the names of the members that a judge adds: its header and its trainings. Its networks are those of the table.
JUDGE = "judge/"

#: The keys of the configuration that decide the rows, beside the data, the seeds and the rules.
DECISIVE = (
    "data.image_size",
    "gate.max_modules",
    "gate.max_flops",
    "gate.max_parameters",
    "llm.space",
    "numerics.kind",
    "task.class_name",
    "task.kind",
    "task.loss",
    "task.output_argument",
    "task.outputs",
    "task.target_scaling",
    "training.batch_size",
    "training.device",
    "training.gpu",
    "training.learning_rate",
    "training.precision",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Header(Record):
    """The data, the settings and the rules that all rows follow from."""

    #: Layout of the file.
    schema: Literal[1] = 1
    #: True where no network was trained: the losses were drawn at random, to measure tools by.
    made_up: bool
    #: The configuration, as `tacevo.records.to_json` writes it; `llm.space` is the space, `training` how each network
    #: trained.
    config: dict[str, FreeJson]
    task: Task
    data: DataFacts
    #: The training seeds; each network is trained with each of them.
    seeds: Annotated[tuple[int, ...], MinLen(1)]
    rules: Rules
    #: Number of the rules of full trainings (`tacevo.rules.STUDY`).
    study: int
    #: The trivial loss of the validation images (`tacevo.training.losses`).
    trivial: Annotated[float, Ge(0)]
    versions: dict[str, str]
    machine: dict[str, FreeJson]

    @property
    def settings(self) -> RunConfig:
        """The configuration.

        Raises:
            ConfigError: this version does not know it.
        """
        training = self.config.get("training")
        if isinstance(training, dict) and type(training.get("seeds")) is int:  # what `seeds` says, in earlier releases
            training = {name: value for name, value in training.items() if name != "seeds"}
        return from_plain({**self.config, "training": training})


@dataclass(frozen=True, slots=True, kw_only=True)
class TableNetwork(Record):
    """A network of the table."""

    #: Value of each gene; None of the task's baseline, whose file is not written by the grammar.
    genome: dict[str, bool | int | float | str] | None
    source: str
    #: SHA-256 of the source.
    sha256: str
    #: Exactly one of these two is there: what the gate measured, or why it refused the network.
    profile: Profile | None = None
    rejection: Rejection | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTraining(Record):
    """A network trained with one seed."""

    #: Row of the network, and of the seed in the header; from 0.
    network: Annotated[int, Ge(0)]
    seed: Annotated[int, Ge(0)]
    #: Exactly one of these two is there.
    full: FullTraining | None = None
    rejection: Rejection | None = None

    @property
    def verdict(self) -> FullTraining | Rejection:
        """The full training, or why it failed."""
        verdict = self.full or self.rejection
        assert verdict is not None  # as reading checks
        return verdict


@dataclass(frozen=True, kw_only=True, eq=False)
class SpaceTable:
    """A table that was read; each network that the gate admitted has a training with each seed.

    A judge is a table of the same networks, in which some have a training with each of its own seeds.
    """

    path: Path
    #: The hash of the rows and of the settings that decide them, so that equal rows are equal data of a search.
    digest: str
    header: Header
    networks: tuple[TableNetwork, ...]
    #: All trainings, by network, then by seed.
    trainings: tuple[TableTraining, ...]
    #: The text of its README.
    card: str
    #: Some of the networks, trained with fresh seeds that judge them; None where the file has no such part.
    judge: "SpaceTable | None" = None
    #: Before the names of its members in the file: empty, or `JUDGE`.
    part: str = ""

    @cached_property
    def by_source(self) -> Mapping[str, int]:
        """The row of each source."""
        return {network.source: row for row, network in enumerate(self.networks)}

    @cached_property
    def verdicts(self) -> Mapping[tuple[int, int], FullTraining | Rejection]:
        """The verdict of each training, by the rows of network and seed."""
        return {(row.network, row.seed): row.verdict for row in self.trainings}

    def test_loss(self, network: int, seed: int) -> float | None:
        """Return the test loss of a training, by the rows of network and seed; None where there is none."""
        verdict = self.verdicts.get((network, seed))
        return verdict.metrics[LOSS[self.header.data.kind]] if isinstance(verdict, FullTraining) else None

    @cached_property
    def test_losses(self) -> Mapping[int, Sequence[float]]:
        """The test losses of each network that trained with every seed, a seed each, by its row."""
        seeds = range(len(self.header.seeds))
        losses = {row: [self.test_loss(row, seed) for seed in seeds] for row in self.trained}
        sound = {row: [loss for loss in each if loss is not None] for row, each in losses.items()}
        return {row: each for row, each in sound.items() if len(each) == len(seeds)}

    @property
    def trained(self) -> tuple[int, ...]:
        """The rows of the networks that have trainings, in the order of these."""
        return tuple(dict.fromkeys(row.network for row in self.trainings))

    @property
    def name(self) -> str:
        """The size and the task of the table, in a line."""
        header = self.header
        what = "MADE UP, not trained: " if header.made_up else ""
        seeds = counted(len(header.seeds), "seed")
        judged = "" if self.judge is None else f"; {self.judge.as_judge}"
        return f"{what}{counted(len(self.networks), 'network')} for {header.task.name}, {seeds} each{judged}"

    @property
    def as_judge(self) -> str:
        """The size of a judge, in words."""
        return f"{len(self.trained)} of them judged by {counted(len(self.header.seeds), 'fresh seed')} each"

    @property
    def failures(self) -> list[str]:
        """A line for each network that the gate refused and each training that failed."""
        refused = [
            f"network {row}: {network.rejection.reason}"
            for row, network in enumerate(self.networks)
            if network.rejection is not None and not self.part
        ]
        return (
            refused
            + failures_of(self.trainings)
            + ([] if self.judge is None else [f"judge: {line}" for line in self.judge.failures])
        )

    @property
    def failed(self) -> str:
        """The numbers of networks that the gate refused and of trainings that failed, in a line, zeros included."""
        refused = sum(network.rejection is not None for network in self.networks)
        failed = sum(row.rejection is not None for row in self.trainings)
        return f"the gate refused {counted(refused, 'network')}, and {counted(failed, 'training')} failed"


def failures_of(trainings: Iterable[TableTraining]) -> list[str]:
    """Return a line for each training that failed."""
    return [
        f"network {row.network}, seed {row.seed}: {row.rejection.reason}"
        for row in trainings
        if row.rejection is not None
    ]


def value_of(config: RunConfig, key: str) -> object:
    """Return the value of one of `DECISIVE`."""
    group, _, name = key.partition(".")
    return getattr(getattr(config, group), name)
