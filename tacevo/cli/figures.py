"""The commands `tacevo figures` and `tacevo ablations`."""

import contextlib
import itertools
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from analysis.report.figure_list import Picture, pictures_of, sweep_pictures, undrawn, with_others, write_pictures
from analysis.report.outputs import outputs
from analysis.report.sweep_collection import SweepCollection
from analysis.report.writing import left_of_studies, write_tables
from analysis.rounding import shown
from analysis.statistics.effects import LEVEL, median_confidence
from analysis.sweeps.arm_metrics import TESTED
from analysis.table import Percent, Table
from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import FORMATS, Format, output_directory, tell
from tacevo.cli.tables import open_all, print_table, remarks_of, say, status_of
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, DataError, RunError
from tacevo.runs.progress import Progress
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.sweeps.status import continuing
from tacevo.text import as_override, counted

#: The most arms, and the most remarks, that are printed of a comparison; the tables have all.
_ARMS, _REMARKS = 8, 4

#: What is printed of it, beside the difference.
_SHORT = frozenset({"arm", "seeds", "median", "p", "p, Holm", "A12"})

_BRACKETS = (
    "Medians and differences over seeds; in brackets intervals that hold the true ones with a chance of {} or more."
)
_A12 = "A12: the chance that the arm has more, with its interval of 95 %."


def run_figures(runs: Sequence[str], places: Sequence[Path], *, formats: Sequence[Format], store: str | None) -> int:
    """Draw the figures of runs and sweeps into files, each in its place."""
    opened = open_all(runs, store)
    endings = _endings(formats)
    for one, place in zip(opened, places, strict=True):
        say(remarks_of(one))
        directory = output_directory(place)
        pictures, missing = drawable(one)
        with progress_of("figures", len(pictures)) as on_drawn:
            written = write_pictures(pictures, directory, endings, on_drawn, missing.append)
        current = {picture.name for picture in written}
        say([*missing, *left_of_studies(directory, current, [f".{name}" for name in FORMATS])])
        tell(f"figures: {directory}")
    return max(map(status_of, opened))


def _endings(formats: Sequence[Format]) -> list[str]:
    return [f".{name}" for name in dict.fromkeys(formats)]


def drawable(one: Run | Sweep) -> tuple[list[Picture], list[str]]:
    """List the figures of a run, sample images first, or of a sweep; and the reasons why others are missing."""
    if isinstance(one, Sweep):
        return _of_sweep(one.collection())
    run, known = one.recorded, outputs()
    missing = [*known.missing.values(), *undrawn(run)]
    brought = known.figures(one.collection, missing.append)
    pictures = with_others(pictures_of(one.collection), brought, missing.append)
    try:
        figure = one.figures["samples"]()
    except (ConfigError, DataError) as error:
        return pictures, [*missing, f"no sample images: {error}"]
    caption = f"Training images of the data set ({run.name})."
    return [Picture(name="samples", caption=caption, draw=lambda: figure), *pictures], missing


def _of_sweep(collected: SweepCollection) -> tuple[list[Picture], list[str]]:
    """List the figures of a sweep, and the reasons why others are missing."""
    known = outputs()
    missing = list(known.missing.values())
    brought = known.sweep_figures(collected, missing.append)
    return with_others(sweep_pictures(collected), brought, missing.append), missing


@contextlib.contextmanager
def progress_of(words: str, total: int) -> Iterator[Callable[[str], None]]:
    """Say how many pictures are drawn; on a terminal, show how far it is."""
    number = itertools.count(1)
    with Progress() as view:
        view.say(f"drawing {total} {words}")
        yield lambda name: view.advance(words, next(number), total)


def run_ablations(
    name: str, place: Path, reference: str | None, *, formats: Sequence[Format], store: str | None
) -> int:
    """Compare the arms of a sweep: write tables and figures, and print the metric that they are compared by first."""
    (sweep,) = open_all([name], store)
    if isinstance(sweep, Run):
        remedy = "`tacevo tables` has those of a run"
        raise RunError("one run", place=name, expected="a sweep", remedy=remedy)
    with Progress() as view:
        view.say("comparing the arms")
        collected = sweep.collection(reference)
        directory = output_directory(place)
        tables, missing = sweep.all_tables(reference)
        write_tables(tables, directory)
    pictures, undrawn_ones = _of_sweep(collected)
    with progress_of("figures", len(pictures)) as on_drawn:
        write_pictures(pictures, directory, _endings(formats), on_drawn, undrawn_ones.append)
    say(dict.fromkeys([*missing, *undrawn_ones]))
    first = f"ablation_{collected.ablation.first.name}"
    print_table(_in_short(next(table for table in tables if table.name == first)), Console())
    remarks = sweep.left_out
    say([*remarks[:_REMARKS], *([f"and {len(remarks) - _REMARKS} more"] if len(remarks) > _REMARKS else [])])
    if collected.sweep.missing:
        tell(f"next:   {continuing(SweepDirectory(Path(name)), as_typed('tacevo'))}")
    elif collected.ablation.primary in TESTED and collected.sweep.terms.retraining is None:
        tell(f"next:   {as_typed('tacevo')} study {shlex.quote(as_override('sweep', name))} seeds=5")
    tell(f"tables and figures: {directory} (index.md says which question each answers)")
    return status_of(sweep)


def _in_short(table: Table) -> Table:
    """Keep what fits on a screen of the comparison in one metric."""
    kept = [place for place, column in enumerate(table.columns) if column in _SHORT or "difference of" in column]
    rows = [[row[place] for place in kept] for row in table.rows]
    seeds = [count for row in table.rows if isinstance(count := row[table.columns.index("seeds")], int) and count > 1]
    chance = min([LEVEL, *map(median_confidence, seeds)])
    return replace(
        table,
        columns=tuple(table.columns[place] for place in kept),
        rows=tuple(map(tuple, rows[:_ARMS])),
        notes=(
            *([f"And {counted(len(rows) - _ARMS, 'arm')} more."] if len(rows) > _ARMS else []),
            _BRACKETS.format(shown(Percent(chance))),
            _A12,
        ),
    )
