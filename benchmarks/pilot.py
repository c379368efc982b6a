"""Is a space worth a table? A pilot: some of its networks, drawn at random, each trained with two seeds.

    python -m benchmarks.pilot                  # the figures of the pilots that were made
    python -m benchmarks.pilot grating --networks 40    # trains on, until there are so many of this one

A table can tell ways to search apart only where good networks differ by more than training seeds do. So a space is
accepted if all five of these hold (docs/plans):

1. its two strongest genes together explain at most 0.4 of the variance of networks' mean log test loss;
2. among the best quarter the ICC of a log test loss is 0.4 or more;
3. at most 1 % of its networks are within 10 % of the best;
4. draws still gain more than 10 % from 50 trainings to 200;
5. fewer than 20 % of the trainings are best in the last tenth of their epochs.

The networks are drawn once, so a larger pilot holds a smaller one. `results/pilots.json` has the genes and losses of
each, so that every figure can be computed again; trainings are kept in `build/pilots` and go on where they stopped.
"""

import argparse
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import KFold, cross_val_predict

from analysis.statistics.seed_noise import icc
from tacevo.config.compose import compose
from tacevo.config.task_texts import load_task
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

#: A loss within this factor of the best one's is as good.
AS_GOOD = 1.1

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

#: The settings of each pilot: those of the demo's data (400 images of 32 px train, 200 validate, 1,400 test) but for
#: what stands here.
PILOTS: Mapping[str, Sequence[str]] = {
    "grating": (),
    "fewer gratings, 100 train": ("data.images=1500", "data.validation_part=0.133", "data.test_part=0.8"),
    "finer gratings": ("data.spacings_mm=[0.75,0.84,0.94,1.05,1.18,1.32,1.48]",),
    "force": ("task=force",),
    "hardness": ("task=hardness",),
}


class Pilot(NamedTuple):
    """The losses of n networks with `SEEDS` seeds each."""

    #: A row a network, a column a gene that varies.
    genes: pd.DataFrame
    #: The logarithm of the test loss, shape (n, SEEDS).
    tests: NDArray[np.float64]
    #: The lowest validation loss, shape (n, SEEDS).
    fitness: NDArray[np.float64]
    #: The part of the trainings that are best in the last tenth of their epochs.
    late: float


def settings_of(name: str) -> list[str]:
    """Return the overrides of a pilot's configuration."""
    return ["experiment=demo", *_COMMON, *PILOTS[name]]


def drawn(networks: int) -> list[dict[str, Any]]:
    """Draw so many different genomes at random; more begin with fewer."""
    every = [dict(zip(GENES, values, strict=True)) for values in itertools.product(*GENES.values())]
    return [every[row] for row in stream(0, "pilot").permutation(len(every))[:networks].tolist()]


def trained(name: str, networks: int) -> dict[str, Any]:
    """Train a pilot, or what is left of it; return what `results/pilots.json` keeps of it."""
    config, view = compose([*settings_of(name), "store.root=build/pilots", "executor.workers=1"]), Progress()
    data = load_data(config, view)
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
    losses: dict[str, list[list[Any]]] = {
        kind: [[None] * SEEDS for _ in rows] for kind in ("test", "fitness", "best_epoch")
    }
    for one in trainings:
        if isinstance(one.full, FullTraining):
            curve = one.full.training.validation_losses
            (loss,) = {"cross_entropy", "mse"} & {*one.full.metrics}
            found = (one.full.metrics[loss], min(curve), int(np.argmin(curve)) + 1)
            for kind, value in zip(losses, found, strict=True):
                losses[kind][one.network][one.seed] = value
    return {"epochs": config.training.epochs, "genomes": genomes, **losses}


def pilot_of(found: Mapping[str, Any]) -> Pilot:
    """Read what is kept of a pilot; a network that failed with a seed is left out."""
    whole = [None not in row for row in found["test"]]
    genes = pd.DataFrame(found["genomes"])[whole]
    varied = [gene for gene in genes if genes[gene].nunique() > 1]
    tests, fitness, best = (
        np.array([row for row, sound in zip(found[kind], whole, strict=True) if sound], dtype=np.float64)
        for kind in ("test", "fitness", "best_epoch")
    )
    late = float((best > 0.9 * found["epochs"]).mean())
    return Pilot(genes[varied].reset_index(drop=True), np.log(tests), fitness, late)


def strongest(pilot: Pilot) -> tuple[float, str]:
    """Return how much two genes explain at most of the variance of the mean log test loss, and which.

    It is the R2 of a mean for each pair of their values, adjusted for the number of pairs, since few networks fall into
    each.
    """
    means, found = pilot.tests.mean(axis=1), []
    for pair in itertools.combinations(pilot.genes, 2):
        cells = pilot.genes[list(pair)].astype(str).agg(" ".join, axis=1)
        left = means - pd.Series(means).groupby(cells).transform("mean").to_numpy()
        free = len(means) - cells.nunique()
        found.append((1 - left.var() * len(means) / free / means.var(ddof=1), " and ".join(pair)))
    return max(found)


def best_quarter(pilot: Pilot) -> NDArray[np.intp]:
    """Return the networks of which others promise the lowest losses: a ridge over the genes, fitted without them."""
    design = pd.get_dummies(pilot.genes.astype(str), dtype=float).to_numpy()
    folds = KFold(10, shuffle=True, random_state=0)
    model = RidgeCV(np.logspace(-2, 3, 11))
    expected = cross_val_predict(model, design, pilot.tests.mean(axis=1), cv=folds)
    return np.argsort(expected, kind="stable")[: len(expected) // 4]


def shrunken(tests: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each network's mean of values of shape (n, S), moved to the mean of all by the part that is seeds'."""
    means = tests.mean(axis=1)
    return np.asarray(means.mean() + reliability(tests) * (means - means.mean()))


def reliability(tests: NDArray[np.float64]) -> float:
    """Return the part of the variance of networks' means that is networks', of values of shape (n, S)."""
    between, within = deviations(tests)
    return float(between**2 / (between**2 + within**2 / tests.shape[1]))


def near(tests: NDArray[np.float64]) -> int:
    """Return how many networks are as good as the best, by shrunken means of log losses of shape (n, S)."""
    levels = shrunken(tests)
    return int((levels <= levels.min() + np.log(AS_GOOD)).sum())


def deviations(tests: NDArray[np.float64]) -> tuple[float, float]:
    """Return the standard deviations between networks and between the seeds of one, of values of shape (n, S)."""
    within = float(tests.var(axis=1, ddof=1).mean())
    return max(0.0, float(tests.mean(axis=1).var(ddof=1)) - within / tests.shape[1]) ** 0.5, within**0.5


def gained(pilot: Pilot, few: int, many: int, repeats: int = 4000) -> float:
    """Return by which part the loss falls of what draws hand over, from few trainings to many.

    One seed chooses and the other judges, both ways; draws are without replacement.
    """
    rng, networks, means = stream(0, "draws"), len(pilot.tests), []
    for count in (few, many):
        losses = []
        for repeat in range(repeats):
            seed, rows = repeat % SEEDS, rng.permutation(networks)[:count]
            losses.append(pilot.tests[rows[pilot.fitness[rows, seed].argmin()], 1 - seed])
        means.append(np.mean(losses))
    return float(1 - np.exp(means[1] - means[0]))


def row_of(name: str, pilot: Pilot) -> str:
    """Lay out what a pilot says of the five, and the deviations; of a small one of fewer draws."""
    explained, pair = strongest(pilot)
    quarter, whole = icc(np.exp(pilot.tests[best_quarter(pilot)])), icc(np.exp(pilot.tests))
    networks = len(pilot.tests)
    few, many = DRAWN if networks >= DRAWN[1] else (networks // 4, networks)
    iccs = [f"{one.estimate:.2f} [{one.low:.2f}, {one.high:.2f}]" if one else "" for one in (quarter, whole)]
    between, within = deviations(pilot.tests)
    figures = [
        f"{explained:.2f} ({pair})",
        *iccs,
        f"{near(pilot.tests) / networks:.0%}",
        f"{gained(pilot, few, many):.0%} ({few} to {many})",
        f"{pilot.late:.0%}",
        f"{between:.2f}, {within:.2f}",
    ]
    return f"| {name} | {networks} | {' | '.join(figures)} |"


def rows(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield the table of all pilots."""
    yield "| pilot | networks | two genes | ICC: best quarter | all | as good | draws gain | late | SD: network, seed |"
    yield f"|{'---|' * 9}"
    for name, one in found.items():
        yield row_of(name, pilot_of(one))


def main() -> None:
    """Train on, and print the figures of all pilots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="?", choices=PILOTS, help="the pilot to train")
    parser.add_argument("--networks", type=int, default=40, metavar="N")
    options = parser.parse_args()
    found = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    if options.name:
        found[options.name] = trained(options.name, options.networks)
        lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(one)}" for name, one in found.items())
        RESULTS.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    print("\n".join(rows(found)))


if __name__ == "__main__":
    main()
