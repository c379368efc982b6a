"""plan.json: how many seeds a study or a sweep needs, as it was planned before anything of it was trained.

It is copied into the study's header or into sweep.json, so that what was planned travels with what was done.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from annotated_types import Ge, Gt, Lt

from tacevo.errors import ConfigError, TacevoError
from tacevo.records import Record, to_json
from tacevo.storage.canonical import readable
from tacevo.storage.signatures import describe, sign
from tacevo.typed import parse


class Measure(StrEnum):
    """The measure of a sample's values: a test score or loss, or the best fitness of a search that was not tested."""

    mse = "mse"
    accuracy = "accuracy"
    #: The geometric mean of the test losses of a job's networks.
    loss = "loss"
    fitness = "fitness"


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedPlan(Record):
    """The number of seeds that was planned, and what it was planned from."""

    LATER: ClassVar[frozenset[str]] = frozenset({"elites", "signature"})

    schema: Literal[1] = 1
    kind: Literal["study", "sweep"]
    task: str
    metric: Measure
    #: The difference that is to be found: the part of an error, in (0, 1), or the difference of an accuracy.
    effect: Annotated[float, Gt(0), Lt(1)]
    #: Level of the tests, after Holm's correction over the comparisons.
    alpha: Annotated[float, Gt(0), Lt(1)]
    #: Wished chance of finding the effect.
    power: Annotated[float, Gt(0), Lt(1)]
    #: Variants against the baseline, or arms against the reference.
    comparisons: Annotated[int, Ge(1)]
    #: Training seeds of each network of a study; jobs of each arm of a sweep.
    seeds: Annotated[int, Ge(2)]
    #: Training seeds of each network that a job found; None of a study, and where jobs are not tested.
    retraining: Annotated[int, Ge(1)] | None
    #: The number of networks of a job that are tested.
    elites: Annotated[int, Ge(1)] = 1
    #: Epochs of each full training; None where there are none.
    epochs: Annotated[int, Ge(1)] | None
    #: Standard deviation of one value, of logarithms for an error: that which was planned with.
    spread: Annotated[float, Ge(0)]
    #: Simulated chance of finding the effect with so many seeds.
    chance: float
    #: Full trainings, of each network and seed.
    trainings: Annotated[int, Ge(0)]
    #: The hours of one worker on the pilot's machine; None where no pilot recorded its times.
    hours: float | None
    #: Digests of the runs whose values gave the spread.
    pilots: tuple[str, ...]
    #: The day of the plan in UTC, by that machine's clock, as 2026-11-22; empty of a plan by an earlier release.
    made: str = ""
    #: A signature of OpenSSH of this file without it (`tacevo.storage.signatures`); empty of a plan that nobody signed.
    signature: str = ""

    @property
    def dated(self) -> str:
        """The day on which the plan was made, in words."""
        return f"made on {self.made}, by its machine's clock" if self.made else "made on a day that was not recorded"


def plan_text(plan: SeedPlan) -> str:
    """Return what plan.json holds."""
    return readable(to_json(plan))


def signed_plan(plan: SeedPlan, key: Path) -> SeedPlan:
    """Return a plan with its signature by the key of a file.

    Raises:
        ConfigError: as `tacevo.storage.signatures.sign`.
    """
    return replace(plan, signature=sign(_unsigned(plan), key))


def describe_plan(plan: SeedPlan, allowed: Path | None, error: type[TacevoError]) -> str:
    """Say in a line when a plan was made, and who signed it; arguments and errors are as of `describe`."""
    if not plan.signature:
        return f"{plan.dated}; unsigned"
    told = describe(
        _unsigned(plan),
        plan.signature.encode(),
        allowed,
        place="plan",
        expected="a plan as it was signed",
        error=error,
    )
    return f"{plan.dated}; {told}"


def _unsigned(plan: SeedPlan) -> str:
    return plan_text(replace(plan, signature=""))


def read_plan(path: Path, kind: Literal["study", "sweep"], task: str) -> SeedPlan:
    """Read a plan for a study or a sweep of a task.

    Raises:
        ConfigError: the file cannot be read or is not such a plan.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            str(error.strerror), place=str(path), expected="a plan.json", remedy=f"`tacevo plan {kind}` writes one"
        ) from error
    plan = parse(SeedPlan, text, place=str(path), error=ConfigError, remedy=f"`tacevo plan {kind}` writes it")
    for name, wanted, stated in (("kind", kind, plan.kind), ("task", task, plan.task)):
        if stated != wanted:
            raise ConfigError(repr(stated), place=f"{path}, {name}", expected=repr(wanted))
    describe_plan(plan, None, ConfigError)
    return plan
