"""Processor time until a search hands a good network over, beside openevolve, on the table of a space.

    make bench                                            on the table; or, alone: python -m benchmarks.reach
    python -m benchmarks.reach --real --searches 5        with real trainings: two hours of a core

A user waits for a good network, not for many candidates. Here a good one is among the best twentieth of the table that
comes with the project (docs/table.md), by its mean test loss over all seeds. A contender's five fittest networks are
trained again with the two seeds that its search has not seen, and the one with the lowest mean loss of these is handed
over. The figure is the expected running time (ERT, as in COCO, hansen2021coco): the processor seconds of all searches,
each until it could first hand a good one over or to its end, divided by the number of searches that could.

Both ask the same grammar for networks of the same space, ours as an experiment does, with crossover; the peer for
a mutation of its current program, with an instruction and a temperature drawn from all. Trainings are looked up: for
each search and network one of the table's seeds, for either the lowest validation loss so far. They are paid by price:
a probe, a start and epochs of a baseline are measured in this run, for as many images as the table's, and epochs count
in proportion to a network's FLOPs. The search itself is measured, and counts in proportion to its trainings.

With `--real` the searches train, and all of their processor time is measured. The table then tells test losses, and
what two further trainings give, which are paid by price.

In favour of the peer: it pays neither probe nor start, since its workers stay warm; nor the grammar, which answers in
a process of the benchmark but in ours; nor a network that it trains again; and it is looked at after each training,
ours after each generation.
"""

import argparse
import heapq
import itertools
import json
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

import tacevo
from benchmarks.confinement import BARE, EPOCHS, Seconds, seconds_of_training
from benchmarks.peers import PYTHON, evaluator_environment, search_cost, serving, write_data
from benchmarks.timing import Figure
from tacevo.choices import Numerics
from tacevo.config.compose import compose
from tacevo.evolution.prompts import mutation_text
from tacevo.llm.grammar.provider import answer
from tacevo.randomness import stream
from tacevo.records import ChatMessage, Request
from tacevo.results.run import read_run
from tacevo.results.space_table import SpaceTable, read_table
from tacevo.training.numerics import environment

EVALUATOR = Path(__file__).with_name("reach_evaluator.py")

#: How many of the fittest are trained again, and for how many epochs.
FITTEST, LONG = 5, 10

FENCED = re.compile(r"```python\n(.*?)```", re.DOTALL)

_CURRENT = re.compile(r"# Current Program\n" + FENCED.pattern, re.DOTALL)


class Visit(NamedTuple):
    """A network that a search trains for the first time."""

    #: Its row in the table.
    network: int
    #: Its lowest validation loss.
    loss: float
    #: Row of the seed in the table that no re-estimate takes: its own; the first one where it was really trained.
    seed: int
    #: When it was trained; after all of one number a search can be looked at.
    generation: int


#: The trainings of a search, in order, and its processor seconds, without them where they are looked up.
Searched = tuple[list[Visit], float]


class Way(NamedTuple):
    """How a contender searches."""

    #: Of a training.
    epochs: int
    #: Of each; it is nothing where the time of the search holds its trainings.
    price: Seconds
    #: Of what is trained again.
    again: Seconds
    #: Searches with a seed.
    search: Callable[[int], Searched]


class Space:
    """What the table knows of each network."""

    def __init__(self, path: Path) -> None:
        table = tacevo.open_table(path)
        networks, scores = table.networks, table.scores
        shape = (len(networks), scores["seed"].nunique(), -1)  # fails where a training has
        losses = table.trainings["validation_loss"].to_numpy().reshape(shape)
        #: The lowest validation loss, by network, seed, and number of epochs less one.
        self.lowest = np.minimum.accumulate(losses, axis=2)
        #: The mean test loss of each network.
        self.test = scores["cross_entropy"].to_numpy().reshape(shape[:2]).mean(axis=1)
        #: The FLOPs of each network, in those of the baseline.
        self.flops = (networks["flops"] / networks["flops"][0]).to_numpy(np.float64)
        self.rows = {source: row for row, source in enumerate(networks["source"])}

    def seconds(self, visit: Visit, epochs: int, price: Seconds) -> float:
        """Return what judging a network takes of a processor."""
        return float(price.probe + price.start + epochs * price.epoch * self.flops[visit.network])

    def again(self, visit: Visit) -> float:
        """Return the mean validation loss of a network under two seeds that its search has not seen."""
        return float(np.delete(self.lowest[visit.network, :, LONG - 1], visit.seed).mean())


def reach(
    *,
    searches: int = 20,
    is_real: bool = False,
    answers: int = 200,
    best: float = 0.05,
    epochs: int = EPOCHS[32],
    rounds: int = 3,
) -> Iterator[Figure]:
    """Search in two ways of ours and in two of openevolve's.

    Args:
        searches: of each; the seeds are the same.
        is_real: whether they train, and do not look trainings up.
        answers: that a search may ask for; twice as many where half of them are skipped.
        best: which part of the space is good.
        epochs: that the prices are measured by, as `seconds_of_training` has it.
        rounds: how often.
    """
    config = compose(["experiment=table"])
    table = read_table(Path(config.data.root or ""))
    space, (trained, predicted, _) = Space(table.path), table.header.data.counts
    prices = seconds_of_training(32, epochs=epochs, rounds=rounds, trained=trained, predicted=predicted)
    confined, bare = prices[f"confined, {config.numerics.kind}"], prices[BARE]._replace(start=0.0)
    experiment = "experiment=space" if is_real else "experiment=table"

    def way(epochs: int, again: Seconds, search: Callable[[int], Searched]) -> Way:
        return Way(epochs, Seconds(0, 0, 0) if is_real else again, again, search)

    def ours(epochs: int, answers: int, *settings: str) -> Way:
        given = (experiment, f"training.epochs={epochs}", *settings)
        return way(epochs, confined, lambda seed: _ours(space, seed, answers, *given))

    def peer(epochs: int) -> Way:
        return way(epochs, bare, lambda seed: _openevolve(table, space, seed, answers, epochs, is_real=is_real))

    mine = {
        "as published, 10 epochs": ours(10, answers),
        "fast, 5 epochs": ours(5, 2 * answers, "proposals.skipped=0.5"),
    }
    peers = {f"openevolve, {epochs} epochs": peer(epochs) for epochs in (10, 5)}
    level = float(np.quantile(space.test, best))
    found = {
        name: [reached(space, way, *way.search(seed), level) for seed in range(searches)]
        for name, way in (mine | peers).items()
    }
    what = "with real trainings" if is_real else "on the table"
    for name, rival in itertools.product(mine, peers):
        yield Figure(
            title=f"until one of the best {best:.0%} is handed over, {what}",
            name=f"{name} ({_told(found[name])})",
            value=expected_seconds(found[name]),
            unit="CPU s",
            peer=f"{rival} ({_told(found[rival])})",
            peer_value=expected_seconds(found[rival]),
        )


def reached(space: Space, way: Way, visits: Sequence[Visit], own: float, level: float) -> tuple[float, bool]:
    """Return the processor seconds of a search until it hands a good network over, or to its end; and whether it does.

    Args:
        space: of the networks.
        way: how it searched.
        visits: its trainings, in order.
        own: its seconds.
        level: the test loss of a network that is good enough.
    """
    seen: list[Visit] = []
    spent, good = 0.0, False
    fittest: list[Visit] = []
    for _, group in itertools.groupby(visits, key=lambda visit: visit.generation):
        for visit in group:
            spent += space.seconds(visit, way.epochs, way.price)
            seen.append(visit)
        fittest = heapq.nsmallest(FITTEST, seen, key=lambda visit: visit.loss)
        good = bool(space.test[min(fittest, key=space.again).network] <= level)
        if good:
            break
    seeds = space.lowest.shape[1] - 1
    again = seeds * sum(space.seconds(visit, LONG, way.again) for visit in fittest)
    return spent + own * len(seen) / len(visits) + again, good


def expected_seconds(found: Sequence[tuple[float, bool]]) -> float:
    """Return the expected running time: all that was spent, for each time that it sufficed.

    Raises:
        RuntimeError: it never did.
    """
    successes = sum(good for _, good in found)
    if not successes:
        raise RuntimeError(f"none of {len(found)} searches hands a good network over; ask for more answers")
    return sum(seconds for seconds, _ in found) / successes


def _told(found: Sequence[tuple[float, bool]]) -> str:
    """Say how many searches succeeded, and between what the figure is with 95 % (bootstrap, percentiles)."""
    seconds, good = np.array(found).T
    rows = stream(0, "reach", "bootstrap").integers(len(found), size=(2_000, len(found)))
    with np.errstate(divide="ignore"):  # of a sample without a success it is infinite
        low, high = np.quantile(seconds[rows].sum(axis=1) / good[rows].sum(axis=1), [0.025, 0.975], method="nearest")
    return f"{int(good.sum())} of {len(found)}; {low:.0f} to {high:.0f}"


def _ours(space: Space, seed: int, answers: int, *settings: str) -> Searched:
    """Search as a user does, with new stores."""
    sizes = compose(settings).search
    generations = (answers - sizes.initial) // sizes.candidates
    with tempfile.TemporaryDirectory() as folder:
        place = (f"run.dir={folder}/run", f"store.root={folder}/cache", "tracking=none")
        given = (*settings, f"seed={seed}", f"search.generations={generations}")
        cost = search_cost([sys.executable, "-m", "tacevo.cli.app", "search", *given, *place], {})
        lines = read_run(Path(folder) / "run").trained
    visits: dict[int, Visit] = {}
    for line in lines:
        assert line.validation_losses is not None
        row, lowest = space.rows[str(line.source)], min(line.validation_losses)
        drawn = np.flatnonzero(space.lowest[row, :, len(line.validation_losses) - 1] == lowest)
        visits.setdefault(row, Visit(row, lowest, int(drawn[0]) if len(drawn) else 0, line.generation))
    return list(visits.values()), cost.processor_seconds


def _openevolve(table: SpaceTable, space: Space, seed: int, answers: int, epochs: int, *, is_real: bool) -> Searched:
    """Search as a user of openevolve does; a server answers as the grammar does when it is asked for a mutation."""
    task, rng = table.header.task, stream(seed, "reach")
    drawn = rng.integers(space.lowest.shape[1], size=len(table.networks)).tolist()
    lock, numbers, unread = threading.Lock(), itertools.count(), list[str]()

    def answer_to(text: str) -> str | None:
        current = _CURRENT.search(text)
        if current is None:
            unread.append(text)
            return None
        with lock:
            instruction = task.instructions[int(rng.integers(len(task.instructions)))].text
            request = Request(
                model="grammar",
                system="",
                messages=(ChatMessage(role="user", content=mutation_text(current[1], instruction)),),
                temperature=float(rng.random()),
                max_tokens=4096,
                draw=next(numbers),
            )
        said = FENCED.search(answer(request, slip_rate=0, space=table.header.settings.llm.space).text)
        if said is None:
            unread.append(text)
        return None if said is None else said[1]

    with tempfile.TemporaryDirectory() as folder, serving(answer_to) as url:
        place = Path(folder)
        peer = {
            "language": "python",
            "diff_based_evolution": False,
            "random_seed": seed,
            "llm": {"models": [{"name": "grammar", "api_base": url, "api_key": "none"}]},
            "evaluator": {"parallel_evaluations": 2, "cascade_evaluation": False},
        }
        (place / "config.yaml").write_text(yaml.safe_dump(peer), encoding="utf-8")
        (place / "initial.py").write_text(task.baseline, encoding="utf-8")
        losses = {
            network.source.strip(): (row, float(space.lowest[row, drawn[row], epochs - 1]))
            for row, network in enumerate(table.networks)
        }
        (place / "losses.json").write_text(json.dumps(losses), encoding="utf-8")
        command = [
            *(str(PYTHON), "-m", "openevolve.cli", f"{place}/initial.py", str(EVALUATOR)),
            *("--config", f"{place}/config.yaml", "--output", f"{place}/output", "--iterations", str(answers)),
        ]
        given = {"PEER_LOSSES": f"{place}/losses.json", "PEER_LOG": f"{place}/log"}
        if is_real:
            settings = ["experiment=space"]
            (place / "trained").mkdir()
            write_data(place, settings)
            given |= evaluator_environment(settings, epochs, data=place, trained=place / "trained")
            given["PYTHONPATH"] = str(EVALUATOR.parents[1])
        cost = search_cost(command, environment(Numerics.fast) | given)
        asked = [json.loads(line) for line in (place / "log").read_text(encoding="utf-8").splitlines()]
    if unread or len(asked) < answers / 2:  # it refuses an answer that equals the parent
        raise RuntimeError(f"openevolve had {len(asked)} of {answers} networks; unread requests: {unread[:1]}")
    visits = [Visit(row, loss, drawn[row], number) for number, (row, loss) in enumerate(dict(asked).items())]
    return visits, cost.processor_seconds


def main() -> None:
    """Print a line a figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", action="store_true", help="train, and do not look trainings up")
    parser.add_argument("--searches", type=int, default=20, metavar="N", help="of each way (default: 20)")
    options = parser.parse_args()
    for figure in reach(searches=options.searches, is_real=options.real):
        print(figure)


if __name__ == "__main__":
    main()
