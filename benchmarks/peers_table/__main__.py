"""Optimisers of others on the table of a space: what each hands over after a few trainings.

    make bench-table
    # another table; the page is left alone
    PYTHONHASHSEED=0 python -m benchmarks.peers_table --table FILE --results FILE

Nothing is timed, so one contender searches after the other. What is known is written after each search: the same
command goes on where it was stopped, until each contender has so many. A search hands over once for each budget: its
network of the lowest fitness. The file holds that network and the seed that evaluated it, so that another judge of the
table needs no new search. A contender of shorter trainings has more of them, so that a budget is one of epochs.
"""

import argparse
import datetime
import importlib
import json
import os
from collections.abc import Callable, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.judging import Space
from benchmarks.peers_table import ours
from benchmarks.peers_table.asking import Genes, Optimiser, Visit, handed_over, visits
from benchmarks.peers_table.figures import REFERENCE, table
from benchmarks.record import with_table
from tacevo.api.space_problems import SpaceProblem
from tacevo.environment import checked_out
from tacevo.records import to_json
from tacevo.results.space_table import read_table
from tacevo.results.table_records import SpaceTable
from tacevo.storage.files import write_durably

TABLE = Path("cache/tables/grating-space.zip")
PAGE = Path("benchmarks/README.md")
RESULTS = Path("benchmarks/results/peers-table.json")

#: Between these lines of the page stands the table.
BEGIN, END = "<!-- make bench-table writes this table -->", "<!-- end of the table of peers -->"

#: Trainings after which a search hands over, and the epochs of one; a contender of short trainings has twice as many.
BUDGETS, EPOCHS, SHORT = (5, 10, 20, 40), 10, 5

#: Answers that a search of ours asks for, a training: a network that comes again is none. The second is of a search
#: that skips half of its answers.
ANSWERS, ANSWERS_SKIPPING = 1.6, 2.2

#: Each contender's epochs, page and function.
OPTIMISERS = {
    REFERENCE: (EPOCHS, "plain", "draws"),
    f"random draws, {SHORT} epochs": (SHORT, "plain", "draws"),
    "regularised evolution": (EPOCHS, "plain", "regularised_evolution"),
    "Optuna, random": (EPOCHS, "by_optuna", "random"),
    "Optuna, TPE": (EPOCHS, "by_optuna", "tpe"),
    "Nevergrad, portfolio (1+1)": (EPOCHS, "by_nevergrad", "one_plus_one"),
    "pyribs, MAP-Elites": (EPOCHS, "by_pyribs", "map_elites"),
    "SMAC3": (EPOCHS, "by_smac", "forest"),
}

#: Each contender's epochs, answers and settings, of this project.
OURS: dict[str, tuple[int, float, tuple[str, ...]]] = {
    "ours, as published": (EPOCHS, ANSWERS, ()),
    f"ours, fast, {SHORT} epochs": (SHORT, ANSWERS_SKIPPING, ("proposals.skipped=0.5",)),
}

LIBRARIES = ("optuna", "nevergrad", "ribs", "smac")

#: The epochs of a contender's trainings, and what searches with a seed.
Contender = tuple[int, Callable[[int], list[Visit]]]


def contenders(rows: SpaceTable, problem: SpaceProblem) -> dict[str, Contender]:
    """Return all who search a table, by name.

    Raises:
        ModuleNotFoundError: a library of theirs is not installed.
    """

    def asked(optimiser: Optimiser, epochs: int) -> Contender:
        trainings, failed = _trainings(epochs)[-1], rows.header.trivial
        return epochs, lambda seed: visits(
            optimiser, problem, seed=seed, trainings=trainings, epochs=epochs, failed=failed
        )

    def own(epochs: int, answers: float, settings: tuple[str, ...]) -> Contender:
        wanted = int(answers * _trainings(epochs)[-1])
        return epochs, lambda seed: ours.visits(rows, seed=seed, answers=wanted, epochs=epochs, settings=settings)

    pages = {page: importlib.import_module(f"benchmarks.peers_table.{page}") for _, page, _ in OPTIMISERS.values()}
    peers = {name: asked(getattr(pages[page], what), epochs) for name, (epochs, page, what) in OPTIMISERS.items()}
    return peers | {name: own(*given) for name, given in OURS.items()}


def _trainings(epochs: int) -> list[int]:
    """Return the budgets in trainings of so many epochs."""
    return [budget * EPOCHS // epochs for budget in BUDGETS]


def searched(contender: Contender, seed: int) -> tuple[list[Visit], int]:
    """Search; return what is handed over after each budget, and the number of trainings."""
    epochs, search = contender
    found, budgets = search(seed), _trainings(epochs)
    return [handed_over(found, budget) for budget in budgets], min(len(found), budgets[-1])


def row_of(table: SpaceTable, genes: Genes) -> int:
    """Find a network of a table by its genes."""
    return next(row for row, network in enumerate(table.networks) if network.genome == genes)


def begun(results: Path, digest: str, rivals: dict[str, Contender]) -> dict[str, Any]:
    """Return what a file holds, or a beginning without a search.

    Raises:
        RuntimeError: it is of another table, of other contenders, or of other versions of their libraries.
    """
    libraries = {name: version(name) for name in LIBRARIES}
    asked = {"table": digest, "epochs": EPOCHS, "budgets": list(BUDGETS), "libraries": libraries}
    names = {name: epochs for name, (epochs, _) in rivals.items()}
    if not results.exists():
        return {**asked, "contenders": {n: {"epochs": e, "searches": [], "trained": []} for n, e in names.items()}}
    measured: dict[str, Any] = json.loads(results.read_text(encoding="utf-8"))
    known = {name: one["epochs"] for name, one in measured["contenders"].items() if "searches" in one}
    if {key: measured.get(key) for key in asked} != asked or known != names:
        raise RuntimeError(f"{results} holds other searches; move it away, or name another file with --results")
    return measured


def main(arguments: Sequence[str] | None = None) -> None:
    """Search, and write what comes out: all of it as JSON, and the project's table into the page.

    Raises:
        SystemExit: the arguments are others than it knows, hashes of texts are random, or a library is missing; nothing
            is searched.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, default=TABLE, help="the table of a space")
    parser.add_argument("--searches", type=int, default=200, help="of each contender, at least 2")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where they are kept; it goes on with these")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these contenders; the others keep what they have")
    given = parser.parse_args(arguments)
    if given.searches < 2:
        parser.error(f"--searches: expected at least 2, which have an interval; got {given.searches}")
    names = [*OPTIMISERS, *OURS]
    if unknown := [name for name in given.only or () if name not in names]:
        parser.error(f"--only: expected some of {'; '.join(names)}; got {'; '.join(unknown)}")
    if os.environ.get("PYTHONHASHSEED") != "0":
        parser.error("expected the environment to set PYTHONHASHSEED=0, or SMAC3's searches do not repeat")
    if missing := [name for name in LIBRARIES if find_spec(name) is None]:
        parser.error(f"{', '.join(missing)} not installed here; `make bench-table` makes build/table-peers")
    space = Space(read_table(given.table))
    problem = space.opened.as_problem()
    rivals = contenders(space.table, problem)
    measured = begun(given.results, space.table.digest, rivals)
    for name in given.only or rivals:
        known = measured["contenders"][name]
        for seed in range(len(known["searches"]), given.searches):
            handed, trained = searched(rivals[name], seed)
            known["searches"].append([[row_of(space.table, visit.genes), visit.seed] for visit in handed])
            known["trained"].append(trained)
            measured["date"], measured["checkout"] = datetime.date.today().isoformat(), to_json(checked_out())
            write_durably(given.results, f"{json.dumps(measured)}\n".encode())
    lines = list(table(space, measured))
    print("\n".join(lines))
    if given.results == RESULTS:
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), lines, BEGIN, END), encoding="utf-8")


if __name__ == "__main__":
    main()
