"""What is left of a record with other training seeds."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import pandas as pd

import tacevo
from analysis.statistics.effects import superiority
from benchmarks.found.bundles import run, sweep
from benchmarks.found.estimates import AFTERWARDS, RANGE, Estimate, ratio

#: The arms of an ablation that were studied, by what they are.
ARMS = {"none": "the method (none)", "drift": "random parents (drift)"}

#: The searches whose winners were trained again, by the fitness of each, and how often they were.
SHORT = "16 searches, 10 epochs, fitness: lowest loss"
LONG = "2 searches, 6 epochs, fitness: last loss"

#: The baseline in every search.
BASELINE = "g00s00"


@dataclass(frozen=True, kw_only=True)
class Winner:
    """The best network of a search on record, and its trainings with other seeds beside those of the baseline."""

    search: str
    #: The seed of the search, which both arms of an ablation share; None of a search by itself.
    seed: int | None
    group: str
    bundle: str
    #: Its loss and the baseline's, on record.
    recorded: tuple[float, float]
    #: Its losses and the baseline's with other seeds.
    again: tuple[pd.Series, pd.Series]

    @property
    def on_record(self) -> float:
        """Its loss on record over the baseline's."""
        return self.recorded[0] / self.recorded[1]

    @property
    def with_other_seeds(self) -> float:
        """Its median loss with other seeds over that of the baseline."""
        own, baseline = self.again
        return float(own.median() / baseline.median())

    @property
    def left(self) -> float:
        """The part of the improvement, 1 less the ratio to the baseline, that is left with other seeds."""
        return (1 - self.with_other_seeds) / (1 - self.on_record)

    @property
    def lead_left(self) -> float:
        """The part of the lead, the baseline's loss less its own, that is left with other seeds."""
        own, baseline = self.again
        return float(baseline.median() - own.median()) / (self.recorded[1] - self.recorded[0])


@cache
def winners() -> tuple[Winner, ...]:
    """Return the best of every published search whose winner and baseline were trained again."""
    elites = sweep("ablation-elites")
    found = [
        _winner(f"{ARMS[job.arm]}, seed {job.seed}", job.seed, SHORT, "ablation-elites", elites.run(str(job.Index)))
        for job in elites.jobs.itertuples()
    ]
    long = (("Claude's", "grating-claude"), ("the grammar's", "grating-grammar"))
    return (*found, *(_winner(name, None, LONG, bundle, run(bundle)) for name, bundle in long))


def _winner(name: str, seed: int | None, group: str, bundle: str, of: tacevo.Run) -> Winner:
    again = next(study.reestimates for study in of.studies if study.reestimates is not None)
    recorded = again.groupby("id").recorded.first()
    best = recorded.drop(BASELINE).idxmin()
    own, baseline = (again.fitness[again.id == each] for each in (best, BASELINE))
    both = float(recorded[best]), float(recorded[BASELINE])
    return Winner(search=f"{name}: {best}", seed=seed, group=group, bundle=bundle, recorded=both, again=(own, baseline))


def pooled() -> Estimate:
    """Return how the winners of the 16 searches compare with their baselines; the arms share their seeds."""
    of_seed: dict[int, list[float]] = {}
    for one in winners():
        if one.seed is not None:
            of_seed.setdefault(one.seed, []).append(math.log(one.with_other_seeds))
    return ratio(
        "all 16 by seed, with other seeds",
        (sum(logs) / len(logs) for logs in of_seed.values()),
        unit="seeds",
        bundle="ablation-elites",
        fixed=AFTERWARDS,
    )


def drawn() -> Iterator[Estimate]:
    """Yield what each winner has of its baseline's loss, on record and with other seeds."""
    for one in winners():
        values = {"on record": (one.on_record, 1), "with other seeds": (one.with_other_seeds, len(one.again[0]))}
        for what, (value, count) in values.items():
            yield Estimate(
                of=f"{one.search}, {what}",
                value=value,
                count=count,
                unit="trainings",
                bundle=one.bundle,
                fixed=AFTERWARDS,
                group=one.group,
            )
    yield pooled()


def written() -> Iterator[Estimate]:
    """Yield what the page says beside its picture."""
    short = [one for one in winners() if one.group == SHORT]
    of_short = partial(Estimate, bundle="ablation-elites", fixed=AFTERWARDS, count=len(short), unit="searches")
    below = sum(one.again[0].max() < one.again[1].min() for one in short)
    of = "winners of which both trainings are below both of the baseline"
    yield of_short(of=of, value=below, form=f"{{:.0f}} of {len(short)}")
    parts = {
        "improvement (1 - loss / baseline) that is left": [100 * one.left for one in short],
        "lead (baseline - loss) that is left": [100 * one.lead_left for one in short],
    }
    for of, values in parts.items():
        ends, middle = (min(values), max(values)), float(np.median(values))
        yield of_short(of=f"median {of}", value=middle, ends=ends, interval=RANGE, form="{:.0f} %")
    for one in winners():
        if one.group == LONG:
            of_long = partial(Estimate, bundle=one.bundle, fixed=AFTERWARDS, count=len(one.again[0]), unit="seeds each")
            chance = superiority(one.again[0], one.again[1])
            of = f"{one.search}: chance that one training of it beats one of the baseline"
            yield of_long(of=of, value=chance.estimate, ends=(chance.low, chance.high), form="{:.3f}")
            yield of_long(of=f"{one.search}: improvement that is left", value=100 * one.left, form="{:.0f} %")
