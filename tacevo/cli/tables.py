"""The command `tacevo tables`, and what it shares with the other commands that show what runs and sweeps found.

A bundle has these tables and figures, too: `tacevo publish` writes them and `tacevo replay` compares them. Nothing here
draws at import: Matplotlib takes a second.
"""

import contextlib
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from analysis.report.collection import side_by_side
from analysis.report.outputs import outputs
from analysis.report.writing import for_paper, left_of_studies, place_of, write_tables
from analysis.rounding import shown
from analysis.table import Table
from analysis.tables.rendering import WRITERS, Notes, Shown, as_latex, as_markdown, as_text, numeric_columns
from tacevo.api.opening import open as open_path
from tacevo.api.runs import Run, remarks_on
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import DIFFERENT, DONE, existing_store, output_directory, tell, tell_markdown
from tacevo.errors import ConfigError, IncomparableError
from tacevo.runs.progress import Progress
from tacevo.text import in_markdown, nearest, printable, unbroken

_INDEXED = "index.md says which question each answers"


def run_tables(
    names: Sequence[str],
    places: Sequence[Path],
    output: str | None,
    *,
    store: str | None,
    paper: bool,
    latex: bool,
    columns: Sequence[str],
    notes: str,
) -> int:
    """Write the tables of runs and sweeps, each in its place, and print those that a paper needs."""
    show = Shown(columns=tuple(columns), notes=Notes(notes))
    opened = open_all(names, store)
    runs = [one for one in opened if isinstance(one, Run)]
    beside = list(with_published(runs)) if paper else []
    if len(opened) == 1:
        _write(opened[0], places[0], show, latex=latex, beside=beside)
        return status_of(opened[0])
    for number, (one, place) in enumerate(zip(opened, places, strict=True), start=1):
        _write(one, place, show, latex=latex, prefix=f"run{number}:")
    if len(runs) > 1:
        tables, alone = side_by_side([one.collection for one in runs])
        say(alone)
        beside += tables
    if output is not None:
        write_tables(beside, output_directory(output), runs=[place.name for place in places], show=show)
    _print(beside, show, latex)
    if output is not None:
        tell(f"tables: {output} ({_INDEXED})")
    return max(map(status_of, opened), default=DONE)


def _write(
    one: Run | Sweep, place: Path, show: Shown, *, latex: bool, beside: Sequence[Table] = (), prefix: str = ""
) -> None:
    """Write the tables of a run or a sweep, and print those that a paper needs; `beside` are the paper's own."""
    directory = output_directory(place)
    with Progress() as view:
        view.say(f"making the tables of {one.name}")
        if isinstance(one, Run) and one.recorded.stores_found:
            view.say(one.recorded.stores_found)
        remarks = remarks_of(one)
        own, missing = one.all_tables()
        tables = [*own, *beside]
        _check_columns(show, tables)
        write_tables(tables, directory, prefix=prefix, show=show)
    say(remarks)
    tell(f"# {in_markdown(one.name)}\n")
    _print(tables, show, latex, prefix)
    say([*missing, *left_of_studies(directory, set(map(place_of, tables)), WRITERS)])
    tell(f"tables: {directory} ({_INDEXED})")


def _check_columns(show: Shown, tables: Sequence[Table]) -> None:
    """Check the names of columns that are to be shown.

    Raises:
        ConfigError: no table has one of them.
    """
    known = {name for table in tables for name in table.columns}
    for name in show.columns:
        if name not in known:
            remedy = nearest(name, known, "the heads of the tables are their names")
            raise ConfigError(repr(name), place="--columns", expected="names of columns", remedy=remedy)


def _print(tables: Iterable[Table], show: Shown, latex: bool, prefix: str = "") -> None:
    """Print the tables that a paper needs."""
    shown_ones = map(show.of, for_paper(tables))
    if latex:
        tell("\n".join(as_latex(table, prefix=prefix) for table in shown_ones))
    else:
        tell_markdown("\n".join(map(as_markdown, shown_ones)) + "\n")


def open_all(names: Sequence[str], store: str | None) -> list[Run | Sweep]:
    """Open what the user named.

    Raises:
        TacevoError: as `tacevo.open`.
    """
    known = existing_store(store)
    with Progress():
        return [open_path(name, store=known) for name in names]


def remarks_of(one: Run | Sweep) -> list[str]:
    """List what is missing of a run or a sweep, a sentence each."""
    return remarks_on(one) if isinstance(one, Run) else list(one.left_out)


def status_of(one: Run | Sweep) -> int:
    """Return the exit status: a study of a run that was left out is a failed check, and so are unequal twins."""
    if isinstance(one, Run):
        return DIFFERENT if one.collection.left_out else DONE
    with contextlib.suppress(IncomparableError):  # of which a report shows the runs, and says why
        return DIFFERENT if one.collection().ablation.unequal_twins else DONE
    return DONE


def print_table(table: Table, console: Console) -> None:
    """Print one table with its notes: laid out for a terminal, else as it is.

    Headings and texts are broken between words; a number is not. Where a terminal is too narrow, an interval goes below
    its number. Where it still is, the table is printed as it is: a column that does not fit is never left out.
    """
    grid = _laid_out(table, console.width) if console.is_terminal else None
    if grid is None:
        tell(as_text(table))
        return
    console.print(grid, "", *(Text(printable(note)) for note in table.notes), "", sep="\n")


#: Characters between two columns.
_GAP = 2


def _laid_out(table: Table, width: int) -> Grid | None:
    """Return a table that needs no more than so many characters a line; None if it needs more."""
    numeric = numeric_columns(table)
    for interval in (" [", "\n["):
        rows = [
            [cell.replace(" [", interval) if is_number else cell for cell, is_number in zip(row, numeric, strict=True)]
            for row in ([printable(shown(cell)) for cell in row] for row in table.rows)
        ]
        columns = list(zip(table.columns, *rows, strict=True))
        least = [_least(*texts, is_number=is_number) for texts, is_number in zip(columns, numeric, strict=True)]
        spare = width - sum(least) - _GAP * (len(least) - 1)
        if spare < 0:
            continue
        grid = Grid(title=Text(printable(table.caption)), title_justify="left", box=None, pad_edge=False)
        for (heading, *cells), needed, is_number in zip(columns, least, numeric, strict=True):
            whole = max(cell_len(line) for text in (heading, *cells) for line in text.split("\n"))
            more = min(spare, whole - needed)
            spare -= more
            grid.add_column(Text(printable(heading)), justify="right" if is_number else "left", width=needed + more)
        for row in rows:
            grid.add_row(*map(Text, row))
        return grid
    return None


def _least(heading: str, *cells: str, is_number: bool) -> int:
    """Return how narrow a column can be: its longest word, or the longest line of its numbers."""
    pieces = [piece for cell in cells for piece in (cell.split("\n") if is_number else cell.split())]
    return max(map(cell_len, [*pieces, *heading.split()]), default=0)


def with_published(runs: Sequence[Run]) -> tuple[Table, ...]:
    """Return the paper's own tables, and with runs the table that compares them."""
    from analysis.tables.published import published_tables

    return (*published_tables(), *outputs().beside([one.recorded for one in runs], lambda reason: say([reason])))


def say(remarks: Iterable[str]) -> None:
    """Print remarks on standard error, a line each."""
    for remark in remarks:
        tell(unbroken(remark), error=True)
