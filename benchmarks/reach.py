"""What a search hands over after so many epochs of training, beside draws and openevolve, on the table of a space.

    python -m benchmarks.reach                               # the figures of the searches in results/reach.json
    python -m benchmarks.reach --searches 400 --fewer 40     # searches on until there are so many: hours

A user spends a budget and takes one network. So a way to search trains until its budget is spent, hands over the
fittest network that it has trained by then, once, and is judged by the mean logarithm of its test loss under seeds that
the search has not seen (`benchmarks.judging.mean`). Nothing is looked at before the budget is spent, and
no test loss decides when to stop.

All ways look the same trainings up, in the table that comes with the project (docs/table.md): of a search and a network
always one of the recorded seeds. One grammar answers for the same space; ours is asked as an experiment asks, with
crossover; openevolve for a mutation of its current program, with an instruction and a temperature drawn from all. A
network costs the epochs of one training, however often a search proposes it. Draws take networks of the space at
random, none twice. Ours train the baseline first, as each search does.

`results/reach.json` holds, of each search, the network and the seed that chose it, so that every figure can be computed
again, by a later judge, too.
"""

import argparse
import itertools
import json
import re
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from analysis.statistics.tests import holm
from benchmarks.judging import Handed, Mean, Space, Visit, mean, of_budget, p_value, written
from benchmarks.peers import openevolve_command, search_cost, serving
from tacevo.choices import Numerics
from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.evolution.algorithm import step
from tacevo.evolution.development import Outcome
from tacevo.evolution.lines import CandidateLine, SearchLine
from tacevo.evolution.prompts import mutation_text
from tacevo.evolution.state import SearchState
from tacevo.gate.extraction import extract
from tacevo.llm.grammar.provider import GrammarLLM, answer
from tacevo.parts import Parents
from tacevo.profile import Admitted
from tacevo.randomness import stream
from tacevo.records import ChatMessage, Completion, Mode, Rejection, Request
from tacevo.results.space_table import read_table
from tacevo.results.table_records import Header
from tacevo.rules import CURRENT
from tacevo.runs.datasets import load_data
from tacevo.runs.decisions import Decisions, Parts
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import training_seed
from tacevo.runs.table_answers import recorded_seeds
from tacevo.runs.wiring import Workbench, build_plan, stores_of
from tacevo.training.numerics import environment

RESULTS = Path(__file__).with_name("results") / "reach.json"

EVALUATOR = Path(__file__).with_name("reach_evaluator.py")

#: Epochs of training after which a search hands a network over.
BUDGETS = (50, 100, 200, 400)

_CURRENT = re.compile(r"# Current Program\n```python\n(.*?)```", re.DOTALL)


class Way(NamedTuple):
    """A way to search."""

    #: Of a training.
    epochs: int
    #: Trains so many networks, or fewer, with a seed of the search.
    search: Callable[[int, int], Sequence[Visit]]


def handed_over(visits: Sequence[Visit], epochs: int, budgets: Sequence[int] = BUDGETS) -> list[Handed]:
    """Return the fittest network of those that each budget pays for; of equally fit ones the first."""
    fittest = [min(visits[: budget // epochs], key=lambda visit: visit.loss) for budget in budgets]
    return [Handed(visit.network, (visit.seed,)) for visit in fittest]


def ways_of(space: Space, store: Path) -> dict[str, Way]:
    """Return every way to search, by its name; ours share a store."""

    def ours(epochs: int, *settings: str) -> Way:
        given = (f"training.epochs={epochs}", f"store.root={store}", *settings)
        return Way(epochs, lambda seed, trainings: searched(space, seed, trainings, given))

    def draws(epochs: int) -> Way:
        return Way(epochs, lambda seed, trainings: at_random(space, seed, trainings, epochs))

    def peer(epochs: int) -> Way:
        return Way(epochs, lambda seed, trainings: _openevolve(space, seed, trainings, epochs))

    return {
        "draws, 10 epochs": draws(10),
        "as published, 10 epochs": ours(10),
        "only the baseline as parent, 10 epochs": ours(10, "ablation=random_parents_only_baseline"),
        "best_k, 10 epochs": ours(10, "ablation=best_k"),
        "drift, 10 epochs": ours(10, "ablation=drift"),
        "openevolve, 10 epochs": peer(10),
        "draws, 5 epochs": draws(5),
        "fast: 5 epochs, a surrogate skips half": ours(5, "proposals.skipped=0.5"),
        "openevolve, 5 epochs": peer(5),
    }


def at_random(space: Space, seed: int, trainings: int, epochs: int) -> list[Visit]:
    """Draw networks of the space, none twice."""
    drawn, rows = space.drawn(seed), stream(seed, "reach", "random").permutation(len(space.rows))[:trainings].tolist()
    return [space.visit(row, drawn[row], epochs) for row in rows]


class _Here(Executor):
    """Runs each job in the thread that submits it."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*args, **kwargs))
        return future


class _Trained:
    """Notes the lines of a search, in place of its ledger."""

    def __init__(self) -> None:
        self.lines: dict[str, CandidateLine] = {}

    def commit(self, line: SearchLine) -> None:
        """Keep the first line of each network that trained."""
        if isinstance(line, CandidateLine) and line.validation_losses is not None:
            self.lines.setdefault(str(line.source), line)

    def developed(self, outcome: Outcome) -> None:
        """Take an outcome."""

    def committed(self, line: SearchLine, state: SearchState) -> None:
        """Take a line and a state."""


def searched(
    space: Space, seed: int, trainings: int, settings: Sequence[str], parents: Parents | None = None
) -> list[Visit]:
    """Search the table as `tacevo search experiment=table` does, decision by decision, until so many have trained.

    A rule for `parents` that is given decides in this process, which is faster than a part's own.
    """
    config = compose(["experiment=table", f"data.root={space.table.path}", f"seed={seed}", "tracking=none", *settings])
    visits = []
    for line in _lines(space, config, trainings, parents)[:trainings]:
        row = space.rows[str(line.source)]
        drawn = recorded_seeds(space.table, seed, space.table.networks[row].source)[training_seed(seed, 0)]
        visits.append(space.visit(row, drawn, config.training.epochs))
    return visits


def _lines(space: Space, config: RunConfig, trainings: int, parents: Parents | None) -> list[CandidateLine]:
    """Search until so many networks have trained, or to the experiment's end; return the line of each."""
    data = load_data(config, Progress())
    task = load_task(config, data.facts)
    notes, seed = _Trained(), training_seed(config.seed, 0)
    with Decisions(stores_of(config).of("decisions", Mode.record)) as decisions:
        plan = build_plan(config, task, data.facts, Mode.record, parts=Parts.of(config, decisions))
        if parents is not None:
            plan = replace(plan, settings=replace(plan.settings, parents=parents))
        with Workbench(config, task, data.facts, Mode.live, data=data) as bench:
            effects, evaluator = bench.effects(CURRENT), bench.evaluator(CURRENT)

            def admit(completion: Completion, asked: str) -> Admitted | Rejection:
                if completion.text not in space.admitted:
                    space.admitted[completion.text] = effects.admit(completion, asked)
                return space.admitted[completion.text]

            quick = replace(
                effects,
                llm=GrammarLLM(slip_rate=config.llm.slip_rate, space=config.llm.space),
                admit=admit,
                evaluate=lambda source: evaluator.retrain(source, seed),
                executor=_Here(),
            )
            state = SearchState(generation=0, temperature=plan.temperature_start, networks=plan.archive)
            while len(notes.lines) < trainings and not state.is_past(plan):
                state = step(state, plan, quick, notes, notes)
    return [*notes.lines.values()]


def _openevolve(space: Space, seed: int, trainings: int, epochs: int) -> list[Visit]:
    """Search as a user of openevolve does. Its workers ask in any order, so no search of it can be repeated.

    It is given twice as many answers as trainings: it refuses one that equals its parent, and repeats some.
    """
    drawn, unread, answers = space.drawn(seed), list[str](), 2 * trainings
    losses = {
        network.source.strip(): (row, space.visit(row, drawn[row], epochs).loss)
        for row, network in enumerate(space.table.networks)
    }
    with tempfile.TemporaryDirectory() as folder, serving(_grammar(space.table.header, seed, unread)) as url:
        place = Path(folder)
        (place / "losses.json").write_text(json.dumps(losses), encoding="utf-8")
        baseline = space.table.header.task.baseline
        command = openevolve_command(place, url=url, baseline=baseline, evaluator=EVALUATOR, answers=answers, seed=seed)
        given = {"PEER_LOSSES": f"{place}/losses.json", "PEER_LOG": f"{place}/log"}
        search_cost(command, environment(Numerics.fast) | given)
        asked = [int(line) for line in (place / "log").read_text(encoding="utf-8").splitlines()]
    if unread or len(asked) < answers / 2:  # it refuses an answer that equals the parent
        raise RuntimeError(f"openevolve had {len(asked)} of {answers} networks; unread requests: {unread[:1]}")
    return [space.visit(row, drawn[row], epochs) for row in dict.fromkeys(asked)][:trainings]


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


def table(space: Space, ways: Mapping[str, Any]) -> str:
    """Lay out what each way hands over by each budget, and beside draws of as many epochs a training.

    A way with fewer than two searches has no row, since its error is not known. Without such draws a way has no row in
    the second table.
    """
    ways = {name: found for name, found in ways.items() if len(found["searches"]) > 1}
    lines = [
        f"| way | searches | {' | '.join(f'{budget} epochs' for budget in BUDGETS)} |",
        f"|---|---|{'---|' * len(BUDGETS)}",
    ]
    compared: list[tuple[str, int, Mean]] = []
    for name, found in ways.items():
        shown = []
        for number, budget in enumerate(BUDGETS):
            handed = of_budget(found, number)
            shown.append(written(mean(space, handed)))
            rival = f"draws, {found['epochs']} epochs"
            if name != rival and rival in ways:
                compared.append((name, budget, mean(space, handed, of_budget(ways[rival], number))))
        lines.append(f"| {name} | {len(found['searches'])} | {' | '.join(shown)} |")
    p = [p_value(one) for _, _, one in compared]
    corrected_p = holm(p) if p else ()
    lines += [
        "",
        "| beside draws | epochs | loss, of theirs [95 %] | p | after Holm | networks |",
        "|---|---|---|---|---|---|",
    ]
    for (name, budget, one), single, corrected in zip(compared, p, corrected_p, strict=True):
        lines.append(f"| {name} | {budget} | {written(one)} | {single:.3g} | {corrected:.3g} | {one.networks} |")
    return "\n".join(lines)


def reach(
    space: Space,
    place: Path,
    searches: int,
    fewer: int,
    ways_of: Callable[[Space, Path], Mapping[str, Way]] = ways_of,
) -> dict[str, Any]:
    """Search in every way until there are so many searches of it, in turn; return what each handed over.

    Args:
        space: of the networks.
        place: of the file, which has all finished searches at any time; those that it has are not made again.
        searches: of each way; the seeds are from 0.
        fewer: of openevolve.
        ways_of: returns the ways, of a space and a store for those that need one.

    Raises:
        SystemExit: the file is of another table, or of other budgets.
    """
    with tempfile.TemporaryDirectory() as store:
        ways = ways_of(space, Path(store))
        found: dict[str, Any] = {
            name: {"epochs": way.epochs, "searches": [], "trained": []} for name, way in ways.items()
        }
        if place.exists():
            recorded = json.loads(place.read_text(encoding="utf-8"))
            if recorded["table"] != space.table.digest:
                raise SystemExit(
                    f"{place} is of the table {recorded['table'][:12]}; expected {space.table.digest[:12]}"
                )
            if recorded["budgets"] != list(BUDGETS):
                raise SystemExit(f"{place} is of the budgets {recorded['budgets']}; expected {list(BUDGETS)}")
            found |= recorded["ways"]
        peers = [name for name in ways if name.startswith("openevolve")]
        turns = [(seed, name) for seed in range(searches) for name in ways if name not in peers]
        for seed, name in turns + [(seed, name) for seed in range(fewer) for name in peers]:
            if seed < len(found[name]["searches"]):
                continue
            visits = ways[name].search(seed, max(BUDGETS) // ways[name].epochs)
            handed = handed_over(visits, ways[name].epochs)
            found[name]["searches"].append([(one.network, *one.seen) for one in handed])
            found[name]["trained"].append(len(visits))
            place.write_text(_written(space.table.digest, found), encoding="utf-8")
    return found


def _written(digest: str, found: Mapping[str, Any]) -> str:
    """Write a way a line; of each search pairs of network and seed, a budget each."""
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(way, separators=(',', ':'))}" for name, way in found.items())
    return f'{{"table": {json.dumps(digest)}, "budgets": {json.dumps(BUDGETS)}, "ways": {{\n{lines}\n}}}}\n'


def main() -> None:
    """Search on, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--searches", type=int, default=0, metavar="N", help="of each way, those recorded included")
    parser.add_argument("--fewer", type=int, default=0, metavar="N", help="of openevolve")
    options = parser.parse_args()
    space = Space(read_table(Path(compose(["experiment=table"]).data.root or "")))
    print(table(space, reach(space, RESULTS, options.searches, options.fewer)))


if __name__ == "__main__":
    main()
