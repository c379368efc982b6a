"""Processor time until a search hands a good network over, beside openevolve, on the table of a space.

    make bench                                            on the table; or, alone: python -m benchmarks.reach
    python -m benchmarks.reach --real --searches 5        with real trainings: hours

A user waits for a good network, not for many candidates. Here a good one is among the best twentieth of the table that
comes with the project (docs/table.md), by its mean test loss over all seeds. A contender's five fittest networks are
trained again with the two seeds that its search has not seen, and the one with the lowest mean loss of these is handed
over. The figure is the expected running time (ERT, as in COCO, hansen2021coco): all processor seconds, those of
searches that find no good network included, divided by the number of searches that do. It is of an ideal stop: a search
ends as soon as what it would hand over is good, and pays for the last re-estimates alone.

One grammar answers for the same space; ours is asked as an experiment asks, with crossover; the peer for a mutation of
its current program, with an instruction and a temperature drawn from all. Trainings are looked up: for each search and
network one of the table's seeds, for all the lowest validation loss so far. They are paid by price: a probe, a start
and epochs of the baseline for forces are measured in this run, for as many images as the table's, and epochs count in
proportion to a network's FLOPs. The search itself is measured, and counts in proportion to its answers. A third way
draws networks of the space at random, and pays as ours for trainings and probes, and for nothing else.

In favour of the peer: its trainings have any instruction set, while ours are portable; it pays neither probe nor start,
since its workers stay warm; nor the grammar, which answers in a process of the benchmark but in ours; nor a network
that it trains again; and it is looked at after each training, ours after each generation.

With `--real` the searches train, and all of their processor time is measured. The table then tells test losses, and
what two further trainings give, which are paid by price.
"""

import argparse
import heapq
import itertools
import json
import math
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.confinement import BARE, EPOCHS, Seconds, seconds_of_training
from benchmarks.peers import evaluator_environment, openevolve_command, search_cost, serving, write_data
from benchmarks.timing import Figure
from tacevo.api.space_tables import SpaceTable as Frames
from tacevo.choices import Numerics
from tacevo.config.compose import compose
from tacevo.evolution.prompts import mutation_text
from tacevo.gate.extraction import extract
from tacevo.llm.grammar.provider import answer
from tacevo.randomness import stream
from tacevo.records import ChatMessage, Rejection, Request
from tacevo.results.run import read_run
from tacevo.results.space_table import read_table
from tacevo.results.table_records import Header, SpaceTable
from tacevo.training.numerics import environment

EVALUATOR = Path(__file__).with_name("reach_evaluator.py")

#: How many of the fittest are trained again, and for how many epochs.
FITTEST, LONG = 5, 10

#: Searches that an interval needs.
FEWEST = 10

_CURRENT = re.compile(r"# Current Program\n```python\n(.*?)```", re.DOTALL)


class Visit(NamedTuple):
    """A network that a search trains for the first time."""

    #: Its row in the table.
    network: int
    #: Its lowest validation loss.
    loss: float
    #: Row of the seed in the table that no re-estimate takes: its own; any where it was really trained.
    seed: int
    #: When it was trained; after all of one number a search can be looked at.
    generation: int


#: The trainings of a search, in order, and all other processor seconds of it.
Searched = tuple[list[Visit], float]


class Way(NamedTuple):
    """How a contender searches."""

    #: Of a training.
    epochs: int
    #: Of a training of the search; zero where it trains, which its own time holds.
    price: Seconds
    #: Of a training again.
    again: Seconds
    #: Searches with a seed.
    search: Callable[[int], Searched]


class Space:
    """What the table knows of each network."""

    def __init__(self, table: SpaceTable) -> None:
        self.table, frames = table, Frames(table)
        networks, scores = frames.networks, frames.scores
        shape = (len(networks), scores["seed"].nunique(), -1)  # fails if a training was rejected
        losses = frames.trainings["validation_loss"].to_numpy().reshape(shape)
        #: The lowest validation loss, by network, seed, and number of epochs less one.
        self.lowest = np.minimum.accumulate(losses, axis=2)
        #: The mean test loss of each network.
        self.test = scores["cross_entropy"].to_numpy().reshape(shape[:2]).mean(axis=1)
        #: The FLOPs of each network, in those of the baseline.
        self.flops = (networks["flops"] / networks["flops"][0]).to_numpy(np.float64)
        self.rows = {source: row for row, source in enumerate(networks["source"])}

    def seconds(self, visit: Visit, epochs: int, price: Seconds) -> float:
        """Return what training a network takes of a processor."""
        return float(price.start + epochs * price.epoch * self.flops[visit.network])

    def again(self, visit: Visit) -> float:
        """Return the mean validation loss of a network under two seeds that its search has not seen."""
        return float(np.delete(self.lowest[visit.network, :, LONG - 1], visit.seed).mean())

    def drawn(self, seed: int) -> NDArray[np.int64]:
        """Draw a seed of the table for each network, for a search that does not draw them itself."""
        return stream(seed, "reach", "noise").integers(self.lowest.shape[1], size=len(self.rows))


def reach(
    *,
    searches: int = 40,
    first: int = 0,
    is_real: bool = False,
    answers: int = 100,
    best: float = 0.05,
    epochs: int = EPOCHS[32],
    rounds: int = 3,
) -> Iterator[Figure]:
    """Search in two ways of ours and in two of openevolve's.

    Args:
        searches: of each; the seeds are the same.
        first: of the seeds.
        is_real: whether they train, and do not look trainings up.
        answers: that a search may ask for; twice as many where half of them are skipped.
        best: which part of the space is good.
        epochs: that the prices are measured by, as `seconds_of_training` has it.
        rounds: how often.
    """
    config = compose(["experiment=table"])
    space = Space(read_table(Path(config.data.root or "")))
    trained, predicted, _ = space.table.header.data.counts
    prices = seconds_of_training(32, epochs=epochs, rounds=rounds, trained=trained, predicted=predicted)
    confined, bare = prices[f"confined, {config.numerics.kind}"], prices[BARE]._replace(start=0.0)

    def way(epochs: int, again: Seconds, search: Callable[[int], Searched]) -> Way:
        return Way(epochs, Seconds(0, 0, 0) if is_real else again, again, search)

    def ours(epochs: int, answers: int, *settings: str) -> Way:
        given, probe = (f"training.epochs={epochs}", *settings), None if is_real else confined.probe
        return way(epochs, confined, lambda seed: _ours(space, seed, answers, given, probe))

    def peer(epochs: int) -> Way:
        return way(epochs, bare, lambda seed: _openevolve(space, seed, answers, epochs, is_real=is_real))

    def drawn(epochs: int) -> Way:
        return Way(epochs, confined, confined, lambda seed: at_random(space, seed, answers, epochs, confined.probe))

    peers = {f"openevolve, {epochs} epochs": peer(epochs) for epochs in (10, 5)}
    random = {f"at random, {epochs} epochs": drawn(epochs) for epochs in (10, 5)}
    mine = {
        "as published, 10 epochs": ours(10, answers),
        "fast, 5 epochs": ours(5, 2 * answers, "proposals.skipped=0.5"),
    }
    level = float(np.quantile(space.test, best))
    ways = mine | peers | ({} if is_real else random)
    outcomes: dict[str, list[tuple[float, bool]]] = {name: [] for name in ways}
    for seed, (name, one) in itertools.product(range(first, first + searches), ways.items()):  # they take turns
        outcomes[name].append(reached(space, one, *one.search(seed), level))
        if is_real:
            print(f"{name}, seed {seed}: {outcomes[name][-1]}", file=sys.stderr, flush=True)
    what = "with real trainings" if is_real else "on the table"
    for name, rival in itertools.product(mine, ways):
        if rival in mine or ways[name].epochs > ways[rival].epochs:
            continue
        yield Figure(
            title=f"until one of the best {best:.0%} is handed over, {what}",
            name=f"{name} ({told(outcomes[name])})",
            value=expected_seconds(outcomes[name]),
            unit="CPU s",
            peer=f"{rival} ({told(outcomes[rival])})",
            peer_value=expected_seconds(outcomes[rival]),
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
    part = (1 + seen[-1].generation) / (1 + visits[-1].generation)
    return spent + own * part + again, good


def expected_seconds(outcomes: Sequence[tuple[float, bool]]) -> float:
    """Return the expected running time of searches: of each its seconds, and whether it succeeded; may be infinite."""
    successes = sum(good for _, good in outcomes)
    return sum(seconds for seconds, _ in outcomes) / successes if successes else math.inf


def told(outcomes: Sequence[tuple[float, bool]]) -> str:
    """Say how many searches succeeded, and between what the figure is with 95 % (bootstrap, percentiles)."""
    seconds, good = np.array(outcomes).T
    succeeded = f"{int(good.sum())} of {len(outcomes)}"
    if len(outcomes) < FEWEST:
        return succeeded
    rows = stream(0, "reach", "bootstrap").integers(len(outcomes), size=(2_000, len(outcomes)))
    with np.errstate(divide="ignore"):  # of a sample without a success it is infinite
        low, high = np.quantile(seconds[rows].sum(axis=1) / good[rows].sum(axis=1), [0.025, 0.975], method="nearest")
    return f"{succeeded}; {low:.0f} to {high:.0f}"


def at_random(space: Space, seed: int, answers: int, epochs: int, probe: float) -> Searched:
    """Draw networks of the space, none twice."""
    drawn = space.drawn(seed)
    rows = stream(seed, "reach", "random").permutation(len(space.rows))[:answers].tolist()
    losses = space.lowest[:, :, epochs - 1]
    return [Visit(row, losses[row, drawn[row]], drawn[row], at) for at, row in enumerate(rows)], probe * len(rows)


def _ours(space: Space, seed: int, answers: int, settings: Sequence[str], probe: float | None) -> Searched:
    """Search as a user does, with new stores.

    Args:
        space: of the networks.
        seed: of the search.
        answers: that it may ask for.
        settings: beside the experiment's.
        probe: the price of one, of each network that is asked for; None of a search that trains.
    """
    experiment = "experiment=space" if probe is None else "experiment=table"
    sizes = compose([experiment]).search
    generations = (answers - sizes.initial) // sizes.candidates
    with tempfile.TemporaryDirectory() as folder:
        place = (f"run.dir={folder}/run", f"store.root={folder}/cache", "tracking=none")
        given = (experiment, *settings, f"seed={seed}", f"search.generations={generations}", *place)
        cost = search_cost([sys.executable, "-m", "tacevo.cli.app", "search", *given], {})
        run = read_run(Path(folder) / "run")
    drawn = space.drawn(seed)
    visits: dict[int, Visit] = {}
    for line in run.trained:
        assert line.validation_losses is not None
        row, lowest = space.rows[str(line.source)], min(line.validation_losses)
        out = drawn[row]
        if probe is not None:
            (out,) = np.flatnonzero(space.lowest[row, :, len(line.validation_losses) - 1] == lowest)
        visits.setdefault(row, Visit(row, lowest, int(out), line.generation))
    probes = len({line.source for line in run.candidates if line.source is not None})
    return list(visits.values()), cost.processor_seconds + probes * (probe or 0.0)


def _openevolve(space: Space, seed: int, answers: int, epochs: int, *, is_real: bool) -> Searched:
    """Search as a user of openevolve does. Its workers ask in any order, so no search of it can be repeated."""
    drawn, unread = space.drawn(seed).tolist(), list[str]()
    losses = {
        network.source.strip(): (row, float(space.lowest[row, drawn[row], epochs - 1]))
        for row, network in enumerate(space.table.networks)
    }
    with tempfile.TemporaryDirectory() as folder, serving(_grammar(space.table.header, seed, unread)) as url:
        place = Path(folder)
        (place / "losses.json").write_text(json.dumps(losses), encoding="utf-8")
        baseline = space.table.header.task.baseline
        command = openevolve_command(place, url=url, baseline=baseline, evaluator=EVALUATOR, answers=answers, seed=seed)
        given = environment(Numerics.fast) | {"PEER_LOSSES": f"{place}/losses.json", "PEER_LOG": f"{place}/log"}
        if is_real:
            settings = ["experiment=space"]
            (place / "trained").mkdir()
            write_data(place, settings)
            given |= evaluator_environment(settings, epochs, data=place, trained=place / "trained", seed=seed)
            given["PYTHONPATH"] = str(EVALUATOR.parents[1])
        cost = search_cost(command, given)
        asked = [json.loads(line) for line in (place / "log").read_text(encoding="utf-8").splitlines()]
    if unread or len(asked) < answers / 2:  # it refuses an answer that equals the parent
        raise RuntimeError(f"openevolve had {len(asked)} of {answers} networks; unread requests: {unread[:1]}")
    visits = [Visit(row, loss, drawn[row], number) for number, (row, loss) in enumerate(dict(asked).items())]
    return visits, cost.processor_seconds


def _grammar(header: Header, seed: int, unread: list[str]) -> Callable[[str], str | None]:
    """Answer as the grammar does when it is asked for a mutation; requests that cannot be read go to `unread`."""
    rng, lock, numbers = stream(seed, "reach"), threading.Lock(), itertools.count()
    task, space = header.task, header.settings.llm.space

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
        said = extract(answer(request, slip_rate=0, space=space), task.contract)
        if isinstance(said, Rejection):
            unread.append(text)
            return None
        return said

    return answer_to


def main() -> None:
    """Print a line a figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", action="store_true", help="train, and do not look trainings up")
    parser.add_argument("--searches", type=int, default=40, metavar="N", help="of each way (default: 40)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the first search (default: 0)")
    options = parser.parse_args()
    for figure in reach(searches=options.searches, first=options.first, is_real=options.real):
        print(figure)


if __name__ == "__main__":
    main()
