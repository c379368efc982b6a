"""How many seeds a study or a sweep needs to find a wished effect, and what they cost, in all ways that are weighed.

A way is a spread, the pilot's own or its upper limit, and of a sweep a number of training seeds for what each job
found. The plan is the cheapest cautious one: a pilot is small, and what is planned by its own spread finds the effect
less often than wished in about half of all cases.
"""

import math
from dataclasses import dataclass

from analysis.statistics.planning import Needed, median_deviation, needed
from analysis.sweeps.pilots import Pilot, is_error
from tacevo.rounding import rounded
from tacevo.storage.plan import Measure, SeedPlan

#: Training seeds of a job's network that are weighed.
RETRAININGS = (1, 3, 5, 10, 20)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What is to be found; `tacevo.storage.plan.SeedPlan` says more of each."""

    effect: float
    alpha: float
    power: float
    comparisons: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """One way to find the effect, and what it costs; without enough seeds nothing is costed."""

    #: Whether its spread is the upper limit of the pilot's.
    cautious: bool
    spread: float
    #: Training seeds of a job's network; None of a study, and where jobs are not tested.
    retraining: int | None
    needed: Needed
    searches: int
    #: Full trainings.
    trainings: int
    #: Of full trainings and searches.
    epochs: int
    hours: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """All ways, and the plan."""

    pilot: Pilot
    wish: Wish
    ways: tuple[Way, ...]
    #: The cautious one of the fewest epochs; None where no number of seeds suffices.
    chosen: Way | None

    @property
    def plan(self) -> SeedPlan | None:
        """What plan.json holds."""
        if self.chosen is None or self.chosen.needed.seeds is None:
            return None
        return SeedPlan(
            kind=self.pilot.kind,
            task=self.pilot.task,
            metric=self.pilot.metric,
            effect=self.wish.effect,
            alpha=self.wish.alpha,
            power=self.wish.power,
            comparisons=self.wish.comparisons,
            seeds=self.chosen.needed.seeds,
            retraining=self.chosen.retraining,
            epochs=self.pilot.epochs,
            spread=self.chosen.spread,
            chance=rounded(self.chosen.needed.chance),
            trainings=self.chosen.trainings,
            hours=self.chosen.hours,
            pilots=self.pilot.runs,
        )


def plan(pilot: Pilot, wish: Wish) -> Planned:
    """Find how many seeds each way needs, and choose."""
    numbers: tuple[int | None, ...] = (None,)
    if pilot.kind == "sweep" and pilot.epochs is not None:
        numbers = RETRAININGS if pilot.within else (1,)  # one training seed a job does not split the spread
    ways = tuple(_way(pilot, wish, cautious, number) for cautious in (False, True) for number in numbers)
    found = [way for way in ways if way.cautious and way.needed.seeds is not None]
    chosen = min(found, key=lambda way: way.epochs) if found else None
    return Planned(pilot=pilot, wish=wish, ways=ways, chosen=chosen)


def _way(pilot: Pilot, wish: Wish, cautious: bool, retraining: int | None) -> Way:
    total = pilot.spread.upper if cautious else pilot.spread.deviation
    between = math.sqrt(max(0.0, total**2 - pilot.tested**2))
    spread = math.hypot(between, pilot.within * median_deviation(retraining or 1))
    found = needed(
        shift=_shift(wish.effect, pilot.metric) / spread if spread else math.inf,
        comparisons=wish.comparisons,
        alpha=wish.alpha,
        power=wish.power,
    )
    seeds = found.seeds or 0
    samples = (wish.comparisons + 1) * seeds
    searches, trainings = 0, samples
    if pilot.kind == "sweep":
        searches, trainings = samples, (samples + seeds) * (retraining or 0)  # the baseline once a seed, for all arms
    epochs = searches * pilot.search_epochs + trainings * (pilot.epochs or 0)
    return Way(
        cautious=cautious,
        spread=rounded(spread),
        retraining=retraining,
        needed=found,
        searches=searches,
        trainings=trainings,
        epochs=epochs,
        hours=None if pilot.seconds is None else rounded(epochs * pilot.seconds / 3600),
    )


def _shift(effect: float, metric: Measure) -> float:
    """Return the effect on the scale of the spread."""
    return -math.log1p(-effect) if is_error(metric) else effect
