"""The command `tacevo tables`, and what it shares with the other commands that show what runs found.

A bundle has these tables and figures, too: `tacevo publish` writes them and `tacevo replay` compares them. Nothing here
draws at import: Matplotlib takes a second.
"""

import argparse
import contextlib
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from analysis.report.collection import Collection, collection_of, compared_studies, read_studies, tables_of
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.report.writing import remove_outdated, write_tables
from analysis.rounding import shown
from analysis.runs.run import Run, finished_run, load_run
from analysis.table import Table
from analysis.tables.published import beside_published, published_tables
from analysis.tables.rendering import WRITERS, as_markdown, numeric_columns, table_texts
from tacevo.bundles.open import Opened, opened
from tacevo.bundles.verify import Rerun
from tacevo.cli.common import DIFFERENT, DONE, RUN, Parser, existing_store, output_directory, place_of_results
from tacevo.config.recorded import RecordedRun
from tacevo.errors import CacheMissError, ConfigError, IncomparableError, RunError
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.sweep_directory import SweepDirectory
from tacevo.text import as_override, printable

#: The remedy where one run is needed and a sweep was named.
_ONE = "compare its arms by `tacevo ablations`, or name one of its jobs, SWEEP/JOB"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gathered:
    """A run with its studies, from a directory or a bundle."""

    recorded: RecordedRun
    found: Collection
    is_bundle: bool

    @property
    def remarks(self) -> list[str]:
        """The settings that were not sent, the studies that were left out, and how to make a first one."""
        remarks = [*self.found.run.not_sent.values(), *(f"left out: {reason}" for reason in self.found.left_out)]
        remarks += self.found.remarks
        if not self.found.studies and not self.found.left_out:
            run = shlex.quote(as_override("run", str(self.found.run.path)))
            make = f"`tacevo study {run}` makes one, with its tables and figures"
            remarks.append(
                "no study: it was published without one" if self.is_bundle else f"no finished study yet: {make}"
            )
        return remarks

    @property
    def status(self) -> int:
        """The exit status: a study that was left out is a failed check."""
        return DIFFERENT if self.found.left_out else DONE

    def tables(self) -> tuple[tuple[Table, ...], list[str]]:
        """Return its tables, and why there are none of motifs: a probe is missing, or a network was edited."""
        try:
            return tables_of(self.found, recall_profiles(self.recorded)), []
        except (CacheMissError, RunError) as error:
            return tables_of(self.found, None), [f"no tables of motifs: {error}"]


def add_tables(parser: Parser) -> None:
    """Describe `tacevo tables`."""
    parser.description = "Print every table of a finished run and its studies, and write them as .tex, .md and .csv."
    parser.add_argument("run", metavar="RUN", nargs="?", help=f"{RUN}; optional with --paper")
    parser.add_argument(
        "--paper", action="store_true", help="the paper's own tables beside corrected values, and beside RUN"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        help="where to write them (default for a directory: RUN/tables; with --paper nothing is written)",
    )
    finish(parser, _tables)


def finish(parser: Parser, command: Callable[[argparse.Namespace], int]) -> None:
    """Describe what all these commands have in common."""
    parser.add_argument("--store", metavar="DIR", help="directory of the stores, if it was moved")
    parser.set_defaults(
        command=command, interrupted="every written file is complete; run the same command again for the rest"
    )


def _tables(options: argparse.Namespace) -> int:
    if options.paper:
        return _paper_tables(options)
    if options.run is None:
        raise ConfigError(
            "neither RUN nor --paper",
            place="tacevo tables",
            expected="the directory or bundle of a run, or --paper for the paper's tables",
        )
    place = place_of(options, "tables")
    with gather(options.run, options.store) as gathered:
        directory = output_directory(place)
        tables, remarks = gathered.tables()
    show(tables, directory)
    names = {table.name for table in tables}
    say([*remarks, *remove_outdated(directory, names, task=gathered.found.run.task, endings=WRITERS)])
    print(f"tables: {directory}")
    return gathered.status


def _paper_tables(options: argparse.Namespace) -> int:
    """Print the paper's own tables, and one that compares a run with them; studies are not read."""
    if options.run is None:
        tables = with_published([])
    else:
        with opened(Path(options.run)) as place:
            tables = with_published([load_run(place.one_run(_ONE))])
    directory = None if options.output is None else output_directory(options.output)
    show(tables, directory)
    if directory is not None:
        print(f"tables: {directory}")
    return DONE


@contextlib.contextmanager
def gather(run: str, store: str | None) -> Iterator[Gathered]:
    """Read a run and its studies from a directory or a bundle, and print what is missing."""
    named = existing_store(store)
    with opened(Path(run)) as place:
        gathered = read_gathered(place.one_run(_ONE), place, named)
        say(gathered.remarks)
        yield gathered


def read_gathered(run: Path, place: Opened, store: str | None) -> Gathered:
    """Read a run and its studies, with the stores of a bundle, or with those that the user named."""
    recorded = place.read(run, store)
    shown = _shown(recorded)
    found = collection_of(shown, read_studies(shown, recorded.stores), recorded.stores)
    return Gathered(recorded=recorded, found=found, is_bundle=place.digest is not None)


def place_of(options: argparse.Namespace, name: str) -> Path:
    """Return where the results of a run are written."""
    return place_of_results(options.output, options.run, name, f"the {name} of a published run")


def show(tables: Iterable[Table], directory: Path | None) -> None:
    """Print tables, and write them into a directory, if there is one."""
    print("\n".join(map(as_markdown, tables)))
    if directory is not None:
        write_tables(tables, directory)


def print_table(table: Table, console: Console) -> None:
    """Print one table with its notes: for a person on a terminal, else as Markdown."""
    if not console.is_terminal:
        print(as_markdown(table))
        return
    grid = Grid(title=Text(printable(table.caption)), title_justify="left", box=None, pad_edge=False)
    cells = [[printable(shown(cell)) for cell in row] for row in table.rows]
    for place, (column, is_number) in enumerate(zip(table.columns, numeric_columns(table), strict=True)):
        words = [*(row[place] for row in cells), *column.split()]  # a heading and a text may be broken, a number not
        width = max(map(len, words)) if is_number else None
        grid.add_column(Text(printable(column)), justify="right" if is_number else "left", width=width)
    for row in cells:
        grid.add_row(*map(Text, row))
    console.print(grid, "", *(Text(printable(note)) for note in table.notes), "", sep="\n")


def with_published(runs: Sequence[Run]) -> tuple[Table, ...]:
    """Return the paper's own tables, and with runs the table that compares them."""
    return (*published_tables(), beside_published(runs)) if runs else published_tables()


def say(remarks: Iterable[str]) -> None:
    """Print remarks on standard error."""
    for remark in remarks:
        print(remark, file=sys.stderr)


def table_files(directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]) -> dict[str, bytes]:
    """Make every table of a run or a sweep from its records and recorded probes; return contents by file name.

    `say` is called with the reason if a sweep has no tables of its arms.
    """
    if SweepDirectory(directory).is_one:
        return _of_sweep(directory, runs, say)[0]
    (done,) = runs
    return _files(tables_of(_collected(done), recall_profiles(done.run)))


def pages(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; return contents by name."""
    from analysis.figures.style import render  # Matplotlib takes a second to import, and a replay draws nothing
    from analysis.report.figure_list import pictures_of, sweep_pictures

    if SweepDirectory(directory).is_one:
        tables, swept = _of_sweep(directory, runs, say)
        pictures = () if swept is None else sweep_pictures(swept)
    else:
        (done,) = runs
        found = _collected(done)
        tables = _files(tables_of(found, recall_profiles(done.run)))
        pictures = pictures_of(found)
    return tables, {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}


def _shown(run: RecordedRun) -> Run:
    """Return a run as the analysis sees it."""
    return finished_run(run.directory, run.record, run.ledger)


def _collected(done: Rerun) -> Collection:
    """Gather a run that was run again, with its studies."""
    run, store = _shown(done.run), done.run.stores
    return collection_of(run, compared_studies(run, done.studies.values(), store), store)


def _of_sweep(
    directory: Path, runs: Sequence[Rerun], say: Callable[[str], object]
) -> tuple[dict[str, bytes], SweepCollection | None]:
    """Make the tables of a sweep, and read what its figures show; without a fair comparison there are none of arms."""
    shown = [_shown(done.run) for done in runs]
    beside, known = beside_published(shown), {run.path.name: run for run in shown}
    try:
        found = collect_sweep(directory, runs[0].run.stores, known=known)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(directory), "the sweep")
        say(f"no table or figure compares the arms: {reason}")
        return _files([beside]), None
    return _files([beside, *sweep_tables(found)]), found


def _files(tables: Iterable[Table]) -> dict[str, bytes]:
    return {name: text.encode() for table in tables for name, text in table_texts(table).items()}
