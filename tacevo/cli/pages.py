"""The tables and figures of a bundle, which `tacevo publish` writes and `tacevo replay` compares."""

from collections.abc import Callable, Iterable
from pathlib import Path

from analysis.figures.style import render
from analysis.report import sweep_collection
from analysis.report.collection import Collection, collect, pictures_of, tables_of
from analysis.report.figure_list import Picture
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

    Args:
        directory: of the run or the sweep.
        store: of its stores.
        say: called with the reason if a sweep has no tables of its arms.
    """
    is_sweep = SweepDirectory(directory).is_one
    return _of_sweep(directory, store, say)[0] if is_sweep else _tables(collect(directory, store), store)


def pages(directory: Path, store: Path, say: Callable[[str], object]) -> tuple[dict[str, bytes], dict[str, bytes]]:
    """Make every table, as `table_files`, and every figure that follows from the records; return contents by name."""
    if SweepDirectory(directory).is_one:
        tables, pictures = _of_sweep(directory, store, say)
        return tables, _drawn(pictures)
    found = collect(directory, store)
    return _tables(found, store), _drawn(pictures_of(found))


def _of_sweep(
    directory: Path, store: Path, say: Callable[[str], object]
) -> tuple[dict[str, bytes], tuple[Picture, ...]]:
    """Make the tables and list the figures of a sweep; without a fair comparison it has none of arms."""
    beside = beside_published([load_run(run) for run in located(directory).runs])
    try:
        found = sweep_collection.collect_sweep(directory, store)
    except IncomparableError as error:  # e.g. budgets that differ; the runs themselves have been replayed
        reason = str(error).replace(str(directory), "the sweep")  # which may lie in a private directory
        say(f"no table or figure compares the arms: {reason}")
        return _files([beside]), ()
    return _files([beside, *sweep_collection.tables_of(found)]), sweep_collection.pictures_of(found)


def _tables(found: Collection, store: Path) -> dict[str, bytes]:
    return _files(tables_of(found, recall_profiles(found.run.path, str(store))))


def _files(tables: Iterable[Table]) -> dict[str, bytes]:
    return {name: text.encode() for table in tables for name, text in table_texts(table).items()}


def _drawn(pictures: Iterable[Picture]) -> dict[str, bytes]:
    return {f"{picture.name}.pdf": render(picture.draw(), ".pdf") for picture in pictures}
