"""The seeds that a study or a sweep needs to find a wished effect, and their cost, in all ways that are weighed.

Of a study there is one way; of a sweep one for each number of training seeds for what a job found. The spread is the
upper limit of the pilot's: what is planned by its own spread finds the effect less often than wished in about half of
all cases, because a pilot is small. The plan is the cheapest way.
"""

import math
from dataclasses import asdict, dataclass

import pandas as pd

from analysis.statistics.planning import needed
from analysis.sweeps.pilots import Pilot, is_error
from tacevo.rounding import rounded
from tacevo.storage.plan_file import SeedPlan

#: Training seeds of each network of a job that are weighed.
RETRAININGS = (1, 3, 5, 10, 20)

#: The columns of the ways, and the type of each: the spread that it is planned with, and the part of it that lies
#: between values that were trained without end; training seeds of a job's network,
#: missing of a study and where jobs are not tested; the seeds it needs, and the simulated chance of so many, or of
#: `analysis.statistics.planning.MOST` where these do not suffice. What follows costs, and is missing there: searches,
#: full trainings, epochs of both, and hours, where the pilot recorded its times.
WAYS = (
    {"between": "float64", "spread": "float64", "retraining": "Int64", "seeds": "Int64", "chance": "float64"}
    | dict.fromkeys(("searches", "trainings", "epochs"), "Int64")
    | {"hours": "float64"}
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """The effect that is to be found; `tacevo.storage.plan_file.SeedPlan` says more of each field."""

    effect: float
    alpha: float
    power: float
    comparisons: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planned:
    """All ways, and the plan."""

    pilot: Pilot
    wish: Wish
    #: A row each (`WAYS`).
    ways: pd.DataFrame
    #: Row of the fewest epochs; None where no number of seeds suffices.
    chosen: int | None

    @property
    def plan(self) -> SeedPlan | None:
        """The content of plan.json."""
        if self.chosen is None:
            return None
        way = self.ways.loc[self.chosen].to_dict()
        return SeedPlan(
            kind=self.pilot.kind,
            task=self.pilot.task,
            metric=self.pilot.metric,
            **asdict(self.wish),
            seeds=int(way["seeds"]),
            retraining=None if pd.isna(way["retraining"]) else int(way["retraining"]),
            elites=self.pilot.elites,
            epochs=self.pilot.epochs,
            spread=way["spread"],
            chance=rounded(way["chance"]),
            trainings=int(way["trainings"]),
            hours=None if pd.isna(way["hours"]) else way["hours"],
            pilots=self.pilot.runs,
        )


def plan(pilot: Pilot, wish: Wish) -> Planned:
    """Find how many seeds each way needs, and choose."""
    numbers: tuple[int | None, ...] = (None,)
    if pilot.kind == "sweep" and pilot.epochs is not None:
        numbers = RETRAININGS if pilot.within else (1,)  # one training seed a job does not split the spread
    ways = pd.DataFrame([_way(pilot, wish, number) for number in numbers], columns=list(WAYS)).astype(WAYS)
    costs = ways.epochs.dropna()
    return Planned(pilot=pilot, wish=wish, ways=ways, chosen=int(costs.idxmin()) if len(costs) else None)


def _way(pilot: Pilot, wish: Wish, retraining: int | None) -> dict[str, float | int | None]:
    between = pilot.between
    spread = math.hypot(between, pilot.noise(retraining or 1))
    shift = -math.log1p(-wish.effect) if is_error(pilot.metric) else wish.effect
    seeds, chance = needed(
        shift=shift / spread if spread else math.inf,
        comparisons=wish.comparisons,
        alpha=wish.alpha,
        power=wish.power,
    )
    way = {
        "between": rounded(between),
        "spread": rounded(spread),
        "retraining": retraining,
        "seeds": seeds,
        "chance": chance,
    }
    if seeds is None:
        return way
    samples = (wish.comparisons + 1) * seeds
    searches, trainings = 0, samples
    if pilot.kind == "sweep":
        # The baseline is trained once a seed, for all arms; for a choice, too.
        searches, trainings = samples, (samples * pilot.elites + seeds) * (retraining or 0)
        trainings += samples * pilot.validated + seeds if pilot.validated else 0
    epochs = searches * pilot.search_epochs + trainings * (pilot.epochs or 0)
    hours = None if pilot.seconds is None else rounded(epochs * pilot.seconds / 3600)
    return {**way, "searches": searches, "trainings": trainings, "epochs": epochs, "hours": hours}
