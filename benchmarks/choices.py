"""Which of the networks that it trained should a search hand over? Better choices, tried among draws on the table.

    python -m benchmarks.choices

The fittest network of many is partly lucky. Three remedies are tried, each at equal epochs of training: a longer
training of the promising (successive halving), a second seed for them (racing), and an estimate that shrinks each
fitness towards what a model expects of such networks. The model is that of the search itself
(`tacevo.evolution.surrogate`), a ridge over what the probe measures; or one of the genes, which a user has in a closed
space alone. Last, a search that draws the next network by a random sample of such a model (Thompson 1933), the bar for
any way that knows the genes.

Every way draws networks of the table, none twice. The judges have not chosen (`benchmarks.judging.mean`). The plan says
which comparison was fixed before the table's judge was looked at. Ten minutes of a core.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import BayesianRidge

import tacevo
from benchmarks.handed_over import against_baseline, studied
from benchmarks.judging import Handed, Space, mean, written
from benchmarks.pilot import Pilot, pilot_of, recorded
from benchmarks.reach import BUDGETS
from benchmarks.written import geometric_mean
from tacevo.evolution.surrogate import features, fit
from tacevo.randomness import stream
from tacevo.results.judged_loss import fresh_losses
from tacevo.results.space_table import read_table
from tacevo.runs.profiles import recall_profiles

#: Searches of each way.
SEARCHES = 400

#: The planned comparison: the second way at the budget before the last, with the first way at the last.
FITTEST, PLANNED = "the fittest, 5 epochs", "the lowest estimate of the search's model, 5 epochs"

#: A published sweep whose elites were trained to the end.
SEARCHED = "cache/published/ablation-elites.zip"

#: The pilots that there were when the plan was made and done.
PILOTED = ("grating", "fewer gratings, 100 train", "finer gratings", "force", "hardness", "hardness, 60 epochs")

#: Networks that a sampled model has to begin with.
FIRST = 5

#: Of what racing spends, the part that goes to second seeds.
RACED = 0.25

#: Successive halving keeps one of so many after each of these numbers of epochs but the last.
KEPT, LEVELS = 3, (5, 10, 20)


class Drawn:
    """The luck of one search: the order in which it draws networks, and the seeds of each in the order of their use."""

    def __init__(self, space: Space, seed: int) -> None:
        self.rng = stream(seed, "choices")
        #: Rows of networks with genes: all but the first, the baseline's file.
        self.order = 1 + self.rng.permutation(len(space.tests) - 1)
        self.seeds = np.array([self.rng.permutation(space.tests.shape[1]) for _ in space.tests])

    def first(self, row: int) -> Handed:
        """Hand over a network of which one training was seen."""
        return Handed(row, (int(self.seeds[row, 0]),))


#: What a choice hands over where it may train for so many epochs.
Choice = Callable[[Drawn, int], Handed]


class Choices:
    """The ways, of one table."""

    def __init__(self, space: Space) -> None:
        self.logs = np.log(space.lowest)
        self.features = [None if one.profile is None else features(one.profile) for one in space.table.networks]
        genes = pd.DataFrame([one.genome for one in space.table.networks[1:]])
        indicators = pd.get_dummies(genes.astype(str), drop_first=True, dtype=float).to_numpy()
        #: A row a network, the baseline's file with none of the values; centred.
        self.genes = np.vstack([np.zeros(indicators.shape[1]), indicators - indicators.mean(axis=0)])

    def ways(self) -> Mapping[str, Choice]:
        """Return every way, by its name; the first is what the others are set beside."""
        ways: dict[str, Choice] = {}
        for epochs in (5, 3, 10):
            ways |= {
                f"the fittest, {epochs} epochs": self._by(epochs, self._fittest),
                f"the lowest estimate of the search's model, {epochs} epochs": self._by(epochs, self._expected),
                f"the lowest estimate of a model of the genes, {epochs} epochs": self._by(epochs, self._by_genes),
                f"a quarter for second seeds, {epochs} epochs": self._raced(epochs),
            }
        return ways | {
            f"successive halving after {', '.join(map(str, LEVELS[:-1]))} of {LEVELS[-1]} epochs": self._halved,
            "any network of the space, by a model of the genes, 5 epochs": self._by(5, self._anywhere),
            "a sampled model of the genes draws, 5 epochs": self._sampled,
        }

    def _fitness(self, drawn: Drawn, rows: NDArray[np.intp], epochs: int, use: int = 0) -> NDArray[np.float64]:
        """Return the logarithm of the lowest loss of so many epochs by the first or second seed of each network."""
        return np.asarray(self.logs[rows, drawn.seeds[rows, use], epochs - 1])

    def _by(self, epochs: int, choose: Callable[[NDArray[np.intp], NDArray[np.float64]], int]) -> Choice:
        def way(drawn: Drawn, budget: int) -> Handed:
            rows = drawn.order[: budget // epochs]
            return drawn.first(choose(rows, self._fitness(drawn, rows, epochs)))

        return way

    @staticmethod
    def _fittest(rows: NDArray[np.intp], fitness: NDArray[np.float64]) -> int:
        return int(rows[fitness.argmin()])

    def _expected(self, rows: NDArray[np.intp], fitness: NDArray[np.float64]) -> int:
        known = [self.features[row] or {} for row in rows.tolist()]
        return int(rows[np.argmin(by_model(known, np.exp(fitness).tolist()))])

    def _by_genes(self, rows: NDArray[np.intp], fitness: NDArray[np.float64]) -> int:
        model = BayesianRidge().fit(self.genes[rows], fitness)
        return int(rows[model.predict(self.genes[rows]).argmin()])

    def _anywhere(self, rows: NDArray[np.intp], fitness: NDArray[np.float64]) -> int:
        return 1 + int(BayesianRidge().fit(self.genes[rows], fitness).predict(self.genes[1:]).argmin())

    def _raced(self, epochs: int) -> Choice:
        def way(drawn: Drawn, budget: int) -> Handed:
            trainings = budget // epochs
            again = max(1, int(RACED * trainings))
            rows = drawn.order[: trainings - again]
            fitness = self._fitness(drawn, rows, epochs)
            best = np.argsort(fitness, kind="stable")[:again]
            both = fitness[best] + self._fitness(drawn, rows[best], epochs, 1)
            row = int(rows[best[both.argmin()]])
            return Handed(row, tuple(drawn.seeds[row, :2].tolist()))

        return way

    def _halved(self, drawn: Drawn, budget: int) -> Handed:
        """Train all for the first number of epochs, and go on with the best of them; epochs are not paid twice."""
        price = sum((level - before) / KEPT**step for step, (before, level) in enumerate(_steps()))
        rows = drawn.order[: max(1, int(budget / price))]
        for level in LEVELS:
            rows = rows[np.argsort(self._fitness(drawn, rows, level), kind="stable")]
            rows = rows[: 1 if level == LEVELS[-1] else max(1, len(rows) // KEPT)]
        return drawn.first(int(rows[0]))

    def _sampled(self, drawn: Drawn, budget: int, epochs: int = 5) -> Handed:
        trained = drawn.order[:FIRST].tolist()
        for _ in range(budget // epochs - FIRST):
            rows = np.array(trained)
            model = BayesianRidge().fit(self.genes[rows], self._fitness(drawn, rows, epochs))
            weights = drawn.rng.multivariate_normal(model.coef_, model.sigma_, method="cholesky")
            promised = self.genes @ weights
            promised[[0, *trained]] = np.inf
            trained.append(int(promised.argmin()))
        rows = np.array(trained)
        return drawn.first(self._by_genes(rows, self._fitness(drawn, rows, epochs)))


def _steps() -> Sequence[tuple[int, int]]:
    return list(zip((0, *LEVELS[:-1]), LEVELS, strict=True))


def by_model(networks: Sequence[Mapping[str, float]], fitness: Sequence[float]) -> list[float]:
    """Return the logarithm of the fitness that the search's model, fitted to all of them, expects of each network."""
    surrogate = fit(list(zip(networks, fitness, strict=True)))
    return [surrogate.predict(one) for one in networks]


def in_pilot(pilot: Pilot, networks: int = 40) -> float:
    """Return the log ratio of what is handed over by the model's estimate and by fitness alone, of all networks.

    One seed chooses and the other judges, both ways. A pilot that was made larger counts with its first networks.
    """
    found = []
    for seed in range(pilot.tests.shape[1]):
        fitness, judged = pilot.fitness[:networks, seed], np.delete(pilot.tests[:networks], seed, axis=1).mean(axis=1)
        estimates = by_model(pilot.features[:networks], fitness.tolist())
        found.append(judged[int(np.argmin(estimates))] - judged[int(fitness.argmin())])
    return float(np.mean(found))


def in_searches(place: str) -> list[float]:
    """Return the same ratio of a sweep's searches, among the elites that a study trained to the end; a value a seed.

    The model is fitted to all that a search trained. Neither choice has seen a seed of the study, so all judge.
    """
    sweep, found = tacevo.open(place), dict[int, list[float]]()
    assert isinstance(sweep, tacevo.Sweep)
    for job, run, study in studied(sweep):
        profiles = recall_profiles(run.recorded)
        fitness = run.candidates["fitness"].dropna()
        trained = [name for name in fitness.index if name in profiles]
        estimates = by_model([features(profiles[name]) for name in trained], fitness[trained].to_list())
        expected = pd.Series(estimates, index=trained)
        names = study.networks["id"].drop("baseline")
        worth = against_baseline(study.scores).mean()
        by_estimate, by_fitness = (worth[each[names].set_axis(names.index).idxmin()] for each in (expected, fitness))
        found.setdefault(job.seed, []).append(by_estimate - by_fitness)
    return [float(np.mean(each)) for each in found.values()]


def elsewhere() -> Iterator[str]:
    """Yield what the choice by the model's estimate gains in the pilots, and in published searches."""
    pilots = {name: in_pilot(pilot_of(one)) for name, one in recorded().items()}
    then = geometric_mean([pilots[name] for name in PILOTED])
    yield f"by the model's estimate, divided by the fittest: {then} in the {len(PILOTED)} pilots of the plan"
    each = ", ".join(f"{name} {math.exp(gain):.2f}" for name, gain in pilots.items())
    yield f"in all {len(pilots)} pilots: {geometric_mean([*pilots.values()])} ({each})"
    searches = in_searches(SEARCHED)
    yield f"the same in published searches: {geometric_mean(searches)}, {len(searches)} seeds"


def on_the_table(space: Space) -> Iterator[str]:
    """Yield a row a way, the same beside the first, and the planned comparison, also where fresh seeds judge both."""
    ways, handed = Choices(space).ways(), dict[str, list[list[Handed]]]()
    yield f"| way | {' | '.join(f'{budget} epochs' for budget in BUDGETS)} |"
    yield f"|{'---|' * (len(BUDGETS) + 1)}"
    for name, way in ways.items():
        handed[name] = [[way(Drawn(space, seed), budget) for seed in range(SEARCHES)] for budget in BUDGETS]
        yield f"| {name} | {' | '.join(written(mean(space, each)) for each in handed[name])} |"
    yield f"\n| divided by {FITTEST} | {' | '.join(f'{budget} epochs' for budget in BUDGETS)} |"
    yield f"|{'---|' * (len(BUDGETS) + 1)}"
    for name, own in handed.items():
        pairs = zip(own, handed[FITTEST], strict=True)
        yield f"| {name} | {' | '.join(written(mean(space, *pair, paired=True)) for pair in pairs)} |"
    half, whole = handed[PLANNED][-2], handed[FITTEST][-1]
    fresh = fresh_losses(space.table)
    both = [
        (one, other) for one, other in zip(half, whole, strict=True) if {one.network, other.network} <= fresh.keys()
    ]
    shares = [f"{sum(one.network in fresh for one in group) / len(group):.0%}" for group in (half, whole)]
    ratio = written(mean(space, half, whole, paired=True))
    yield f"\n{PLANNED} after {BUDGETS[-2]}, divided by {FITTEST} after {BUDGETS[-1]}: {ratio}"
    yield f"fresh seeds judge {' and '.join(shares)} of what they hand over"
    if len(both) > 1:
        one, other = (list(group) for group in zip(*both, strict=True))
        yield f"where they judge both, in {len(both)} pairs: {written(mean(space, one, other, paired=True))}"


def main() -> None:
    """Print the planned choice in the pilots and in published searches, then all ways on the table."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for line in elsewhere():
        print(line, flush=True)
    for line in on_the_table(Space(read_table(Path("cache/tables/grating-space.zip")))):
        print(line, flush=True)


if __name__ == "__main__":
    main()
