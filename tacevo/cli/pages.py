"""The tables and figures of a bundle, which `tacevo publish` writes and `tacevo replay` compares."""

from collections.abc import Callable, Iterable
from pathlib import Path

from analysis.report.collection import collect, tables_of
from analysis.report.sweep_collection import SweepCollection, collect_sweep, sweep_tables
from analysis.runs.run import load_run
from analysis.table import Table
from analysis.tables.published import beside_published
from analysis.tables.rendering import table_texts
from tacevo.bundles.open import located
from tacevo.errors import IncomparableError
from tacevo.runs.profiles import recall_profiles
from tacevo.storage.sweep_directory import SweepDirectory


def table_files(directory: Path, store: Path, say: Callable[[str], object]) -> dict[str, bytes]:
    """Make every table of a run or a sweep from its records and recorded probes; return contents by file name.

    `say` is called with the reason if a sweep has no tables of its arms.
    """
    if SweepDirectory(directory).is_one:
        return _of_sweep(directory, store, say)[0]
    return _files(tables_of(collect(directory, store), recall_profiles(directory, str(store))))


def pages(directory: Path, store: Path, say: Callable[[str], object]) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; return contents by name."""
    from analysis.figures.style import render  # Matplotlib takes a second to import, and a replay draws nothing
    from analysis.report.figure_list import pictures_of, sweep_pictures

    if SweepDirectory(directory).is_one:
        tables, swept = _of_sweep(directory, store, say)
        pictures = () if swept is None else sweep_pictures(swept)
    else:
        found = collect(directory, store)
        tables = _files(tables_of(found, recall_profiles(directory, str(store))))
        pictures = pictures_of(found)
    return tables, {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}


def _of_sweep(
    directory: Path, store: Path, say: Callable[[str], object]
) -> tuple[dict[str, bytes], SweepCollection | None]:
    """Make the tables of a sweep, and read what its figures show; without a fair comparison there are none of arms."""
    beside = beside_published([load_run(run) for run in located(directory).runs])
    try:
        found = collect_sweep(directory, store)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(directory), "the sweep")  # which may lie in a private directory
        say(f"no table or figure compares the arms: {reason}")
        return _files([beside]), None
    return _files([beside, *sweep_tables(found)]), found


def _files(tables: Iterable[Table]) -> dict[str, bytes]:
    return {name: text.encode() for table in tables for name, text in table_texts(table).items()}
