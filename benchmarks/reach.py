"""Processor time until a search can hand over a good network, beside openevolve, on the table of a space.

    make bench          or, alone: python -m benchmarks.reach

Both ask the same grammar for networks of the same space: the peer to change the program that it has at hand, ours to
cross two, as well. Their trainings are looked up in the table that comes with the project (docs/table.md), with one of
its seeds that each search draws for each network; a network that comes again is not paid again.

A search hands over the best of its five fittest networks, once these were trained again, with the seeds that it has
not seen. The figure is the processor time at which this one's loss is below `LOSS`, the median of many searches. It is
of the search itself, which is measured, of its trainings, and of the ten further ones. A training of the table's
baseline costs what one of the like baseline for forces takes in this run, and other networks in proportion to their
FLOPs; ours pay the start of a confined process, too.
"""

import itertools
import json
import math
import re
import statistics
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from benchmarks.confinement import BARE, EPOCHS, Seconds, seconds_of_training
from benchmarks.peers import PYTHON, Search, search_cost, serving
from benchmarks.timing import Figure
from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.prompts import mutation_text
from tacevo.llm.grammar.provider import answer
from tacevo.randomness import stream
from tacevo.records import ChatMessage, Request
from tacevo.results.run import read_run
from tacevo.results.space_table import SpaceTable, read_table
from tacevo.training.full import FullTraining

EVALUATOR = Path(__file__).with_name("reach_evaluator.py")

SETTINGS = ("experiment=table", "tracking=none")

#: How many epochs ours train, by what the way is called.
WAYS = {"the paper's way, 10 epochs": 10, "the fast way, 5 epochs": 5}

#: What the mean validation loss of two trainings has to be below; 12 of the 769 networks are so good.
LOSS = 0.24

#: How many of the fittest are trained again, each with the two other seeds.
FITTEST = 5

#: Epochs of what is trained again.
LONG = 10

FENCED = re.compile(r"```python\n(.*?)```", re.DOTALL)

_CURRENT = re.compile(r"# Current Program\n" + FENCED.pattern, re.DOTALL)


class Trained(NamedTuple):
    """A training of a search."""

    #: Row of the network and of its seed in the table.
    network: int
    seed: int
    epochs: int
    fitness: float


class Losses:
    """The lowest validation losses of a table's trainings by number of epochs, and what these cost."""

    def __init__(self, table: SpaceTable) -> None:
        runs = np.full((len(table.networks), len(table.header.seeds), table.header.settings.training.epochs), np.inf)
        for place, verdict in table.verdicts.items():
            if isinstance(verdict, FullTraining):
                runs[place] = verdict.training.validation_losses
        self._runs, self.seeds = runs, len(table.header.seeds)
        #: By network, seed and number of epochs, less one.
        self.lowest = np.minimum.accumulate(runs, axis=2)
        self._rows = {network.sha256: row for row, network in enumerate(table.networks)}
        self._flops = [1 if row.profile is None else row.profile.training_flops for row in table.networks]

    def seconds(self, network: int, epochs: int, price: Seconds) -> float:
        """Return what a training takes of a processor."""
        return price.start + epochs * price.epoch * self._flops[network] / self._flops[0]

    def trained(self, line: CandidateLine) -> Trained:
        """Find a training of ours in the table, by its losses."""
        assert line.validation_losses is not None
        assert line.fitness is not None
        row, epochs = self._rows[str(line.source)], len(line.validation_losses)
        seed = (self._runs[row, :, :epochs] == line.validation_losses).all(axis=1).argmax()
        return Trained(row, int(seed), epochs, line.fitness)

    def again(self, trained: Trained) -> float:
        """Return the mean loss of a network with the seeds that its search has not seen."""
        return float(np.delete(self.lowest[trained.network, :, LONG - 1], trained.seed).mean())


def reach(
    *, searches: int = 30, answers: int = 200, loss: float = LOSS, epochs: int = EPOCHS[32], rounds: int = 3
) -> Iterator[Figure]:
    """Search the table in each way of ours and with openevolve, which trains as long as the paper's way, or ours.

    Args:
        searches: of each; the seeds are the same.
        answers: that a search may ask for.
        loss: that what is handed over has to be below.
        epochs: that the prices are measured by.
        rounds: how often.
    """
    config = compose(SETTINGS)
    table = read_table(Path(config.data.root or ""))
    losses, prices = Losses(table), seconds_of_training(32, epochs=epochs, rounds=rounds)
    price, bare = prices[f"confined, {config.numerics.kind}"], prices[BARE]._replace(start=0)
    peers = {
        length: statistics.median(
            until(loss, losses, bare, *_openevolve(table, losses, seed, answers, length)) for seed in range(searches)
        )
        for length in sorted(set(WAYS.values()), reverse=True)
    }
    for name, length in WAYS.items():
        ours = statistics.median(
            until(loss, losses, price, *_ours(config, losses, seed, answers, length)) for seed in range(searches)
        )
        for theirs, median in peers.items():
            yield Figure(
                title=f"until a network below {loss:g} can be handed over, on the table",
                name=name,
                value=ours,
                unit="CPU s",
                peer=f"openevolve, {theirs} epochs",
                peer_value=median,
            )


def until(loss: float, losses: Losses, price: Seconds, trained: Sequence[Trained], own: float) -> float:
    """Return the processor seconds until what would be handed over is below a loss; infinity where it never is.

    The `own` ones of the search are spread over its trainings alike.
    """
    best: dict[int, Trained] = {}
    spent = 0.0
    for number, one in enumerate(trained, start=1):
        if one.network in best:
            continue
        best[one.network] = one
        spent += losses.seconds(one.network, one.epochs, price)
        fittest = sorted(best.values(), key=lambda each: each.fitness)[:FITTEST]
        if min(map(losses.again, fittest)) < loss:
            again = [losses.seconds(each.network, LONG, price) for each in fittest]
            return spent + own * number / len(trained) + (losses.seeds - 1) * sum(again)
    return math.inf


def _ours(config: RunConfig, losses: Losses, seed: int, answers: int, epochs: int) -> tuple[list[Trained], float]:
    """Search as a user does; return the trainings in order, and the processor seconds of the command."""
    generations = (answers - config.search.initial) // config.search.candidates
    with tempfile.TemporaryDirectory() as folder:
        place = (f"run.dir={folder}/run", f"store.root={folder}/cache")
        settings = (f"seed={seed}", f"training.epochs={epochs}", f"search.generations={generations}")
        command = [sys.executable, "-m", "tacevo.cli.app", "search", *SETTINGS, *settings, *place]
        cost = search_cost(Search(command=command, environment={}, trained=list))
        lines = read_run(Path(folder) / "run").trained
    return [losses.trained(line) for line in lines], cost.processor_seconds


def _openevolve(table: SpaceTable, losses: Losses, seed: int, answers: int, epochs: int) -> tuple[list[Trained], float]:
    """Search as a user of openevolve does; the server answers as the grammar does, which is asked for a mutation."""
    space, task, rng = table.header.settings.llm.space, table.header.task, stream(seed, "reach")
    drawn = rng.integers(losses.seeds, size=len(table.networks)).tolist()
    lock, asked = threading.Lock(), itertools.count()

    def answer_to(text: str) -> str | None:
        current = _CURRENT.search(text)
        assert current is not None
        with lock:
            instruction = task.instructions[int(rng.integers(len(task.instructions)))].text
            request = Request(
                model="grammar",
                system="",
                messages=(ChatMessage(role="user", content=mutation_text(current[1], instruction)),),
                temperature=float(rng.random()),
                max_tokens=4096,
                draw=next(asked),
            )
        said = FENCED.search(answer(request, slip_rate=0, space=space).text)
        return None if said is None else said[1]

    with tempfile.TemporaryDirectory() as folder, serving(answer_to) as url:
        settings = {
            "language": "python",
            "diff_based_evolution": False,
            "random_seed": seed,
            "llm": {"models": [{"name": "grammar", "api_base": url, "api_key": "none"}]},
            "evaluator": {"parallel_evaluations": 2, "cascade_evaluation": False},
        }
        place = Path(folder)
        (place / "config.yaml").write_text(yaml.safe_dump(settings), encoding="utf-8")
        (place / "initial.py").write_text(task.baseline, encoding="utf-8")
        rows = {
            network.source.strip(): (row, float(losses.lowest[row, drawn[row], epochs - 1]))
            for row, network in enumerate(table.networks)
        }
        (place / "table.json").write_text(json.dumps(rows), encoding="utf-8")
        command = [
            *(str(PYTHON), "-m", "openevolve.cli", f"{place}/initial.py", str(EVALUATOR)),
            *("--config", f"{place}/config.yaml", "--output", f"{place}/output", "--iterations", str(answers)),
        ]
        given = {"PEER_TABLE": f"{place}/table.json", "PEER_LOG": f"{place}/log"}
        cost = search_cost(Search(command=command, environment=given, trained=list))
        visited = map(int, (place / "log").read_text(encoding="utf-8").split())
        trained = [
            Trained(row, drawn[row], epochs, float(losses.lowest[row, drawn[row], epochs - 1])) for row in visited
        ]
    return trained, cost.processor_seconds


if __name__ == "__main__":
    for figure in reach():
        print(figure)
