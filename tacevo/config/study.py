"""The settings of a study or a noise run; see `tacevo.config.schema`."""

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Gt, Lt
from pydantic import BeforeValidator

from tacevo.choices import ChosenBy, MarginKind
from tacevo.config.schema import ExecutorConfig, Memory, OneToMillion, Positive, Text, is_a
from tacevo.records import Record
from tacevo.rounding import rounded


def _as_tuple(value: Any) -> Any:
    """Take one path or name for a list of one."""
    return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value


def _is_all_or_count(value: int | str) -> bool:
    return value == "all" or (isinstance(value, int) and value >= 1)


def _is_named(value: str | None) -> bool:
    return value != ""


@dataclass(frozen=True, kw_only=True)
class StudyStoreConfig(Record):
    """The place where trainings are recorded."""

    #: The directory of the stores; None for that of the run's.
    root: Text | None


@dataclass(frozen=True, kw_only=True)
class Margin(Record):
    """The largest difference from the baseline that still counts as equality."""

    #: The largest difference, in parts of the baseline's median or errors (0.1 is 10 %), or in the unit of the metric.
    value: Positive
    kind: MarginKind

    def around(self, median: float, *, is_share: bool) -> float:
        """Return the margin in the unit of the metric, around a baseline's median; a share is better near 1."""
        match self.kind:
            case MarginKind.absolute:
                return self.value
            case MarginKind.errors if is_share:
                return rounded(self.value * (1 - median))
            case _:
                return rounded(self.value * abs(median))


@dataclass(frozen=True, kw_only=True)
class MarginsConfig(Record):
    """A margin for each kind of task."""

    #: The margin of the test MSE.
    regression: Margin
    #: The margin of the test accuracy, in [0, 1].
    classification: Margin


@dataclass(frozen=True, kw_only=True)
class _TrainedAgain(Record):
    """The settings that a study and a noise run have in common."""

    executor: ExecutorConfig
    #: The directory of a finished run; None where a sweep is named, or networks are given.
    run: Annotated[str | None, is_a("the directory of a finished run, as in run=runs/NAME", _is_named)]
    #: The directory of a sweep, each of whose jobs is taken; None where there is none.
    sweep: Annotated[str | None, is_a("the directory of a sweep, as in sweep=sweeps/NAME", _is_named)]
    #: S, the training seeds of each network.
    seeds: OneToMillion
    store: StudyStoreConfig


@dataclass(frozen=True, kw_only=True)
class StudyConfig(_TrainedAgain):
    """The full training of a baseline and other networks, each with several seeds."""

    #: Files of given networks, directories and patterns of such; () where a run has them, or for the baseline alone.
    networks: Annotated[tuple[Text, ...], BeforeValidator(_as_tuple)]
    #: The arms of a sweep whose jobs are studied; () for all.
    arms: Annotated[tuple[Text, ...], BeforeValidator(_as_tuple)]
    #: k, how many elites of the network archive, best validation fitness first; the baseline comes on top.
    elites: OneToMillion
    #: The quantity by which the best elites are chosen.
    choose: ChosenBy
    epochs: OneToMillion
    #: The wall time of one training, at most.
    seconds: Positive
    memory_mib: Memory
    #: Level of the tests, which Holm's correction keeps over all variants.
    alpha: Annotated[float, Gt(0), Lt(1)]
    margins: MarginsConfig
    #: The plan.json that it follows; it is kept in the study.
    plan: Annotated[str | None, is_a("the file of a plan, as in plan=build/plan/plan.json", _is_named)]


@dataclass(frozen=True, kw_only=True)
class NoiseConfig(_TrainedAgain):
    """The search's own training of a run's elites and its baseline, with other seeds."""

    #: The number of elites of the network archive, or all, best validation fitness first; the baseline comes on top.
    elites: Annotated[int | str, is_a("all, or an integer of at least 1", _is_all_or_count)]
