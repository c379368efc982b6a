"""The searches of this project: whole runs of Algorithm 1, whose answers come from the grammar."""

import io
import tempfile
from pathlib import Path

from rich.console import Console

from benchmarks.peers_table.asking import Visit
from tacevo.config.compose import compose
from tacevo.llm.grammar.parsing import parse
from tacevo.llm.grammar.space import nearest
from tacevo.records import to_json
from tacevo.results.run import read_run
from tacevo.results.table_records import DECISIVE, SpaceTable, value_of
from tacevo.runs.progress import Progress
from tacevo.runs.session import search
from tacevo.text import as_overrides
from tacevo.training.full import FullTraining


def visits(table: SpaceTable, *, seed: int, answers: int, epochs: int, settings: tuple[str, ...] = ()) -> list[Visit]:
    """Search as `experiment=table` does, in this table; return its trainings, in order.

    It begins with the task's baseline, whose file is judged as the network of the space that the grammar reads in it.

    Args:
        table: in which trainings are looked up.
        seed: of the search.
        answers: that it asks the grammar for, the first generation included.
        epochs: of each training.
        settings: beside the experiment's.
    """
    chosen = ["experiment=table", "tracking=none", f"task={table.header.task.name}", *_decisive(table)]
    sizes = compose(chosen).search
    chosen += [f"search.generations={(answers - sizes.initial) // sizes.candidates}", f"training.epochs={epochs}"]
    with tempfile.TemporaryDirectory() as folder:
        place = (f"run.dir={folder}/run", f"store.root={folder}/cache")
        search(compose([*chosen, *settings, f"seed={seed}", *place]), Progress(Console(file=io.StringIO())))
        trained = read_run(Path(folder) / "run").trained
    rows = {network.sha256: row for row, network in enumerate(table.networks)}
    found: dict[int, Visit] = {}
    for line in trained:
        row = rows[str(line.source)]
        if row not in found:
            assert line.fitness is not None
            assert line.validation_losses is not None
            found[row] = Visit(_genes(table, row), _seed(table, row, line.validation_losses), line.fitness)
    return list(found.values())


def _decisive(table: SpaceTable) -> list[str]:
    """Write the settings that a search in a table must share with it."""
    made, usual = table.header.settings, compose(["experiment=table", f"task={table.header.task.name}"])
    pairs: list[tuple[str, object]] = [("data.root", str(table.path))]
    for key in DECISIVE:
        value = to_json(value_of(made, key))
        if value == to_json(value_of(usual, key)):
            continue
        pairs += (
            [(f"{key}.{name}", part) for name, part in value.items()] if isinstance(value, dict) else [(key, value)]
        )
    return as_overrides(pairs)


def _genes(table: SpaceTable, row: int) -> dict[str, bool | int | float | str]:
    network, space = table.networks[row], table.header.settings.llm.space
    assert space is not None  # a problem was made of it
    return dict(network.genome or nearest(space, parse(network.source)))


def _seed(table: SpaceTable, row: int, losses: tuple[float, ...]) -> int:
    """Find the recorded seed whose training begins with these losses."""
    for seed in range(len(table.header.seeds)):
        verdict = table.verdicts[row, seed]
        if isinstance(verdict, FullTraining) and verdict.training.validation_losses[: len(losses)] == losses:
            return seed
    raise RuntimeError(f"network {row} has no recorded training that begins with {losses}")
