"""The command `tacevo tables`, and what it shares with the other commands that show what runs found.

A bundle has these tables and figures, too: `tacevo publish` writes them and `tacevo replay` compares them. Nothing here
draws at import: Matplotlib takes a second.
"""

import argparse
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from analysis.report.writing import remove_outdated, write_tables
from analysis.rounding import shown
from analysis.table import Table
from analysis.tables.published import beside_published, published_tables
from analysis.tables.rendering import WRITERS, as_markdown, numeric_columns
from tacevo.api.opening import ONE_RUN, open_run
from tacevo.api.runs import Run
from tacevo.bundles.open import opened
from tacevo.cli.common import DIFFERENT, DONE, RUN, Parser, existing_store, output_directory, place_of_results
from tacevo.errors import ConfigError
from tacevo.results.run import RecordedRun as Record
from tacevo.results.run import read_run
from tacevo.text import as_override, printable


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
    run = gather(options.run, options.store)
    directory = output_directory(place)
    tables, remarks = run.all_tables()
    show(tables, directory)
    names = {table.name for table in tables}
    say([*remarks, *remove_outdated(directory, names, task=run.collection.run.task, endings=WRITERS)])
    print(f"tables: {directory}")
    return status_of(run)


def _paper_tables(options: argparse.Namespace) -> int:
    """Print the paper's own tables, and one that compares a run with them; studies are not read."""
    if options.run is None:
        tables = with_published([])
    else:
        place = opened(Path(options.run))
        tables = with_published([read_run(place.one_run(ONE_RUN))])
    directory = None if options.output is None else output_directory(options.output)
    show(tables, directory)
    if directory is not None:
        print(f"tables: {directory}")
    return DONE


def gather(name: str, store: str | None) -> Run:
    """Open a run, and print what is missing of its studies."""
    run = open_run(name, store=existing_store(store))
    say(remarks_on(run))
    return run


def remarks_on(run: Run) -> list[str]:
    """List the settings that were not sent, the studies that were left out, and how to make a first one."""
    found = run.collection
    remarks = [*found.run.not_sent.values(), *(f"left out: {reason}" for reason in found.left_out), *found.remarks]
    if not found.studies and not found.left_out:
        named = shlex.quote(as_override("run", str(run.path)))
        make = f"`tacevo study {named}` makes one, with its tables and figures"
        is_bundle = run.place.digest is not None
        remarks.append("no study: it was published without one" if is_bundle else f"no finished study yet: {make}")
    return remarks


def status_of(run: Run) -> int:
    """Return the exit status: a study that was left out is a failed check."""
    return DIFFERENT if run.collection.left_out else DONE


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


def with_published(runs: Sequence[Record]) -> tuple[Table, ...]:
    """Return the paper's own tables, and with runs the table that compares them."""
    return (*published_tables(), beside_published(runs)) if runs else published_tables()


def say(remarks: Iterable[str]) -> None:
    """Print remarks on standard error."""
    for remark in remarks:
        print(remark, file=sys.stderr)
