"""Is a space worth a table? A pilot: some of its networks, drawn at random, each trained with two seeds.

    python -m benchmarks.pilot                  # the figures of the pilots that were made
    python -m benchmarks.pilot grating --networks 40    # trains on, until there are so many of this one

A table can tell ways to search apart only where good networks differ by more than training seeds do. So a space is
accepted if all five of these hold (docs/plans):

1. its two strongest genes together explain at most 0.4 of the variance of networks' mean log test loss;
2. among the best quarter the ICC of a log test loss is 0.4 or more;
3. at most 1 % of its networks are within 10 % of the best;
4. draws still gain more than 10 % from 50 trainings to 200, as expected of normal values;
5. fewer than 20 % of the trainings are best in the last tenth of their epochs.

The networks are drawn once, so a larger pilot holds a smaller one. `results/pilots.json` has the genes and losses of
each, so that every figure can be computed again; trainings are kept in `build/pilots` and go on where they stopped.
"""

import argparse
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import norm
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold, cross_val_predict

from analysis.statistics.seed_noise import deviations, icc
from benchmarks.space import AS_GOOD
from benchmarks.written import interval
from tacevo.config.compose import compose
from tacevo.config.task_texts import load_task
from tacevo.data.dataset import Dataset, with_fingerprint
from tacevo.evolution.surrogate import features
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.space import member
from tacevo.randomness import stream
from tacevo.records import Mode
from tacevo.rules import CURRENT
from tacevo.runs.datasets import load_data
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.wiring import Workbench
from tacevo.studies.tabulate import network_of, train_rows
from tacevo.training.full import FullTraining

RESULTS = Path(__file__).with_name("results") / "pilots.json"

SEEDS = 2

#: Numbers of trainings between which draws shall still gain.
DRAWN = (50, 200)

RESAMPLES = 2000

#: What the first table has settled is fixed: BatchNorm and max pooling.
GENES: Mapping[str, Sequence[Any]] = {
    "depth": (2, 3, 4, 5),
    "width": (8, 16, 24),
    "kernel": (3, 5, 7),
    "activation": ("relu", "gelu", "elu"),
    "norm": ("batch",),
    "down": ("max",),
    "residual": (False, True),
    "pooling": ("average", "max", "both"),
    "hidden": (64, 256),
    "dropout": (0.0, 0.5),
}

_COMMON = ("tracking=none", "training.epochs=20", "training.fitness=lowest")


class Setup(NamedTuple):
    """What a pilot trains on, and how, beside the demo's data: 400 images of 32 px train, 200 validate, 1,400 test."""

    settings: Sequence[str] = ()
    #: Standard deviation of normal noise on the scaled labels of the training images alone, where labels are numbers.
    noise: float = 0.0


_FEWER = ("data.images=1500", "data.validation_part=0.133", "data.test_part=0.8")
_SMALL_BATCHES = ("training.batch_size=8",)

PILOTS: Mapping[str, Setup] = {
    "grating": Setup(),
    "fewer gratings, 100 train": Setup(_FEWER),
    "finer gratings": Setup(("data.spacings_mm=[0.75,0.84,0.94,1.05,1.18,1.32,1.48]",)),
    "force": Setup(("task=force",)),
    "hardness": Setup(("task=hardness",)),
    "hardness, 60 epochs": Setup(("task=hardness", "training.epochs=60")),
    "fewer gratings, 100 train, batches of 8, 60 epochs": Setup((*_FEWER, *_SMALL_BATCHES, "training.epochs=60")),
    "hardness, 100 train, batches of 8, 60 epochs": Setup(
        ("task=hardness", *_FEWER, *_SMALL_BATCHES, "training.epochs=60")
    ),
    "hardness, batches of 8": Setup(("task=hardness", *_SMALL_BATCHES)),
    "hardness, batches of 8, noisy labels": Setup(("task=hardness", *_SMALL_BATCHES), noise=0.1),
}


class Pilot(NamedTuple):
    """The losses of n networks with `SEEDS` seeds each."""

    #: A row a network, a column a gene that varies.
    genes: pd.DataFrame
    #: What the search's own model sees of each (`tacevo.evolution.surrogate`).
    features: Sequence[Mapping[str, float]]
    #: The logarithm of the test loss, shape (n, SEEDS).
    tests: NDArray[np.float64]
    #: The lowest validation loss, shape (n, SEEDS).
    fitness: NDArray[np.float64]
    #: The part of the trainings that are best in the last tenth of their epochs.
    late: float


def settings_of(name: str) -> list[str]:
    """Return the overrides of a pilot's configuration."""
    return ["experiment=demo", *_COMMON, *PILOTS[name].settings]


def drawn(networks: int) -> list[dict[str, Any]]:
    """Draw so many different genomes at random; more begin with fewer."""
    every = [dict(zip(GENES, values, strict=True)) for values in itertools.product(*GENES.values())]
    return [every[row] for row in stream(0, "pilot").permutation(len(every))[:networks].tolist()]


def trained(name: str, networks: int) -> dict[str, Any]:
    """Train a pilot, or what is left of it; return what `results/pilots.json` keeps of it."""
    config, view = compose([*settings_of(name), "store.root=build/pilots"]), Progress()
    data = with_noise(load_data(config, view), PILOTS[name].noise)
    task = load_task(config, data.facts)
    signature, genomes = parse(task.baseline).signature, drawn(networks)
    with Workbench(config, task, data.facts, Mode.record, data=data) as bench:
        gate, rows = bench.gate(CURRENT), {}
        for row, genome in enumerate(genomes):
            network = member(genome, signature)
            blocks = tuple(replace(block, kernel=genome["kernel"]) for block in network.blocks)
            source = render(replace(network, blocks=blocks))
            rows[row] = network_of(gate.inspect(source), genome, source)
        seeds = [training_seed(config.seed, number) for number in range(SEEDS)]
        trainings = train_rows(bench, seeds, rows, data, view)
    found: dict[str, list[list[Any]]] = {
        kind: [[None] * SEEDS for _ in rows] for kind in ("test", "fitness", "best_epoch")
    }
    for one in trainings:
        if isinstance(one.full, FullTraining):
            curve = one.full.training.validation_losses
            (loss,) = {"cross_entropy", "mse"} & {*one.full.metrics}
            values = (one.full.metrics[loss], min(curve), int(np.argmin(curve)) + 1)
            for kind, value in zip(found, values, strict=True):
                found[kind][one.network][one.seed] = value
    seen = [None if row.profile is None else features(row.profile) for row in rows.values()]
    return {"epochs": config.training.epochs, "genomes": genomes, "features": seen, **found}


def with_noise(data: Dataset, deviation: float) -> Dataset:
    """Add normal noise to the scaled labels of the training images: what is validated and tested stays exact.

    Raises:
        ValueError: the labels are classes.
    """
    if not deviation:
        return data
    if not np.issubdtype(data.targets.dtype, np.floating):
        raise ValueError("noise: expected labels that are numbers; got classes")
    targets = data.targets.copy()
    noise = stream(0, "pilot", "noise").normal(scale=deviation, size=targets[data.train].shape)
    targets[data.train] += noise.astype(targets.dtype)
    return with_fingerprint(replace(data, targets=targets))


def pilot_of(found: Mapping[str, Any]) -> Pilot:
    """Read what is kept of a pilot; a network that failed with a seed is left out."""
    whole = [row for row, losses in enumerate(found["test"]) if None not in losses]
    genes = pd.DataFrame(found["genomes"]).iloc[whole]
    varied = [gene for gene in genes if genes[gene].nunique() > 1]
    tests, fitness, best = (
        np.array([found[kind][row] for row in whole], dtype=np.float64) for kind in ("test", "fitness", "best_epoch")
    )
    late = float((best > 0.9 * found["epochs"]).mean())
    known = [found["features"][row] for row in whole]
    return Pilot(genes[varied].reset_index(drop=True), known, np.log(tests), fitness, late)


def strongest(pilot: Pilot) -> tuple[float, str]:
    """Return how much of the variance of the mean log test loss two genes explain at most, and which.

    It is the part that lies between the pairs of their values, adjusted for the number of pairs, since few networks
    fall into each. The noise of seeds, which no gene explains, makes it smaller; that the largest of all pairs of genes
    is taken makes it larger.
    """
    means, found = pilot.tests.mean(axis=1), []
    for pair in itertools.combinations(pilot.genes, 2):
        cells = pilot.genes[list(pair)].astype(str).agg(" ".join, axis=1)
        left = means - pd.Series(means).groupby(cells).transform("mean").to_numpy()
        free = len(means) - cells.nunique()
        explained = 1 - float(left.var()) * len(means) / free / float(means.var(ddof=1))
        found.append((explained, " and ".join(pair)))
    return max(found)


def best_quarter(pilot: Pilot) -> NDArray[np.intp]:
    """Return the networks of which others promise the lowest losses: a ridge over the genes, fitted without them."""
    design = pd.get_dummies(pilot.genes.astype(str), dtype=float).to_numpy()
    folds = KFold(10, shuffle=True, random_state=0)
    model = RidgeCV(np.logspace(-2, 3, 11))
    expected = cross_val_predict(model, design, pilot.tests.mean(axis=1), cv=folds)
    return np.argsort(expected, kind="stable")[: len(expected) // 4]


def near(tests: NDArray[np.float64]) -> float:
    """Return the part of the whole space that is as good as its best network, expected of normal values.

    Only the deviation between networks enters, since a sample's best is not the space's.
    """
    between, _ = deviations(tests)
    if between == 0:
        return 1.0
    best = float(norm.ppf(1 - 1 / prod(map(len, GENES.values()))))
    return float(norm.sf(best - np.log(AS_GOOD) / between))


def gained(pilot: Pilot) -> float:
    """Return by which part the loss falls of what draws hand over, between the two numbers of `DRAWN`.

    Expected of normal values: of n draws the fittest lies E(n) standard deviations of a log fitness below the mean,
    where E(n) is the mean of the largest of n normal values, and its log test loss under the other seed falls by the
    covariance of both over that deviation.
    """
    fitness, slopes = np.log(pilot.fitness), []
    for seed in range(SEEDS):
        judged = np.delete(pilot.tests, seed, axis=1).mean(axis=1)
        slopes.append(np.cov(fitness[:, seed], judged)[0, 1] / fitness[:, seed].std(ddof=1))
    few, many = (largest(count) for count in DRAWN)
    return float(1 - np.exp(-np.mean(slopes) * (many - few)))


@cache
def largest(count: int) -> float:
    """Return the mean of the largest of so many standard normal values."""
    return float(quad(lambda x: x * count * norm.pdf(x) * norm.cdf(x) ** (count - 1), -10, 10, points=[2])[0])


def with_bootstrap(pilot: Pilot, figure: Callable[[Pilot], float]) -> tuple[float, float, float]:
    """Return a figure and its 95 % interval by resampled networks (percentiles)."""
    rng, found = stream(0, "bootstrap"), []
    for _ in range(RESAMPLES):
        rows = rng.integers(len(pilot.tests), size=len(pilot.tests))
        found.append(figure(pilot._replace(tests=pilot.tests[rows], fitness=pilot.fitness[rows])))
    low, high = np.percentile(found, (2.5, 97.5)).tolist()
    return figure(pilot), low, high


def table_lines(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of all pilots: the five figures, the ICC of all networks, and the deviations."""
    yield "| pilot | networks | two genes | ICC: best quarter | all | as good | draws gain | late | SD: network, seed |"
    yield f"|{'---|' * 9}"
    for name, one in found.items():
        pilot = pilot_of(one)
        explained, pair = strongest(pilot)
        parts = [icc(np.exp(tests)) for tests in (pilot.tests[best_quarter(pilot)], pilot.tests)]
        between, within = deviations(pilot.tests)
        gain = with_bootstrap(pilot, gained)
        figures = [
            f"{explained:.2f} ({pair})",
            *("" if part is None else interval(part.estimate, part.low, part.high) for part in parts),
            f"{near(pilot.tests):.1%}",
            "{:.0%} [{:.0%}, {:.0%}]".format(*gain),
            f"{pilot.late:.0%}",
            f"{between:.2f}, {within:.2f}",
        ]
        yield f"| {name} | {len(pilot.tests)} | {' | '.join(figures)} |"


def recorded() -> dict[str, Any]:
    """Read `results/pilots.json`."""
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return found


def main() -> None:
    """Train on, and print the figures of all pilots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="?", choices=PILOTS, help="the pilot to train")
    parser.add_argument("--networks", type=int, default=40, metavar="N")
    options = parser.parse_args()
    if options.name:
        there = len(recorded().get(options.name, {"genomes": []})["genomes"])
        if options.networks < there:
            parser.error(f"--networks: expected {there} or more, which are recorded; got {options.networks}")
        pilot = trained(options.name, options.networks)
        found = recorded() | {options.name: pilot}  # read now: another pilot may have ended
        lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(one)}" for name, one in found.items())
        RESULTS.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    print("\n".join(table_lines(recorded())))


if __name__ == "__main__":
    main()
