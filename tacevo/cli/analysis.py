"""The commands that show what runs found: `tacevo tables | figures | report | paper | ablations`."""

import argparse
import contextlib
import itertools
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from analysis.report import sweep_collection
from analysis.report.collection import Collection, collect, pictures_of, tables_of, with_one_study
from analysis.report.document import ENGINES, Chapter, make_pdf, write_document
from analysis.report.figure_list import Picture, undrawn
from analysis.report.page.contents import PageContents
from analysis.report.page.html import as_html
from analysis.report.page.of_run import RunMaterial, read_recorded
from analysis.report.page.whole import page_contents
from analysis.report.writing import remove_outdated, write_chapter, write_pictures, write_tables
from analysis.runs.run import Run, load_run
from analysis.studies.study import check_alike
from analysis.table import Table
from analysis.tables.published import beside_published, published_tables
from analysis.tables.rendering import WRITERS, as_markdown
from tacevo.bundles.open import Opened, opened
from tacevo.cli.common import DIFFERENT, DONE, Parser, existing_store, output_folder, place_of_results
from tacevo.cli.report_page import checked, commands, page_of_sweep, samples_of
from tacevo.errors import CacheMissError, ConfigError, DataError, RunError
from tacevo.runs.data_check import samples_of_run
from tacevo.runs.profiles import recall_profiles
from tacevo.runs.progress import Progress
from tacevo.storage.files import write_durably
from tacevo.text import listed

_FORMATS = ("pdf", "svg", "png")

_RUN = "the directory or bundle of a run"

#: The remedy where one run is needed and a sweep was named.
_ONE = "compare its arms by `tacevo ablations`, or name the directory of one of its jobs"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Gathered:
    """A run with its studies, from a directory or a bundle."""

    found: Collection
    #: The directory of the stores that it is read with; None for the run's own.
    store: str | None
    is_bundle: bool


def add_tables(parser: Parser) -> None:
    """Describe `tacevo tables`."""
    parser.description = "Print every table of a finished run and its studies, and write them as .tex, .md and .csv."
    parser.add_argument("run", metavar="RUN", nargs="?", help="the directory or bundle of a run; optional with --paper")
    parser.add_argument(
        "--paper", action="store_true", help="the paper's own tables beside corrected values, and beside RUN"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        help="where to write them (default for a directory: RUN/tables; with --paper nothing is written)",
    )
    _finish(parser, _tables)


def add_figures(parser: Parser) -> None:
    """Describe `tacevo figures`."""
    parser.description = "Draw every figure of a finished run and its studies."
    parser.add_argument("run", metavar="RUN", help=_RUN)
    parser.add_argument(
        "-o", "--output", metavar="DIR", help="where to write them (default for a directory: RUN/figures)"
    )
    parser.add_argument("--format", nargs="+", choices=_FORMATS, default=_FORMATS, help="default: all three")
    _finish(parser, _figures)


def add_report(parser: Parser) -> None:
    """Describe `tacevo report`."""
    parser.description = (
        "Write one HTML file with which a finished run and its studies, or a finished sweep, can be looked into."
    )
    parser.add_argument("run", metavar="RUN", help="the directory or bundle of a run or a sweep")
    parser.add_argument("-o", "--output", metavar="FILE", help="default for a directory: RUN/report.html")
    _finish(parser, _report)


def add_paper(parser: Parser) -> None:
    """Describe `tacevo paper`."""
    parser.description = (
        "Write every table and figure of finished runs and their studies, a LaTeX document that holds them all, and "
        "its PDF where LaTeX is installed."
    )
    parser.add_argument("runs", metavar="RUN", nargs="+", help=_RUN)
    parser.add_argument("-o", "--output", metavar="DIR", default="build/paper", help="default: build/paper")
    _finish(parser, _paper)


def add_ablations(parser: Parser) -> None:
    """Describe `tacevo ablations`."""
    parser.description = (
        "Compare the arms of a sweep by its finished jobs: print tables, and write them as .tex, .md and .csv, with "
        "figures as .pdf."
    )
    parser.add_argument("sweep", metavar="DIR", help="the directory or bundle of a sweep")
    parser.add_argument(
        "-o", "--output", metavar="OUT", help="where to write them (default for a directory: DIR/ablations)"
    )
    _finish(parser, _ablations)


def _finish(parser: Parser, command: Callable[[argparse.Namespace], int]) -> None:
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
            "neither",
            place="tacevo tables",
            expected="the directory or bundle of a run, or --paper for the paper's tables",
        )
    place = _place(options, "tables")
    with _collected(options.run, options.store) as gathered:
        found, folder = gathered.found, output_folder(place)
        tables, remarks = _own_tables(gathered)
    print("\n".join(map(as_markdown, tables)))
    write_tables(tables, folder)
    gone = remove_outdated(folder, {table.name for table in tables}, task=found.run.task, endings=WRITERS)
    _say([*remarks, *map(_removed, gone)])
    print(f"tables: {folder}")
    return _status([found])


def _paper_tables(options: argparse.Namespace) -> int:
    """Print the paper's own tables, and one that compares a run with them; studies are not read."""
    if options.run is None:
        tables = _published([])
    else:
        with opened(Path(options.run)) as place:
            tables = _published([load_run(place.one_run(_ONE))])
    folder = None if options.output is None else output_folder(options.output)
    print("\n".join(map(as_markdown, tables)))
    if folder is not None:
        write_tables(tables, folder)
        print(f"tables: {folder}")
    return DONE


def _figures(options: argparse.Namespace) -> int:
    place = _place(options, "figures")
    with _collected(options.run, options.store) as gathered:
        found, folder = gathered.found, output_folder(place)
        pictures, remarks = _pictures(gathered)
    endings = [f".{name}" for name in dict.fromkeys(options.format)]
    with _shown("figures", len(pictures)) as on_drawn:
        write_pictures(pictures, folder, endings, on_drawn)
    names = {picture.name for picture in pictures}
    gone = remove_outdated(folder, names, task=found.run.task, endings=[f".{name}" for name in _FORMATS])
    _say([*remarks, *map(_removed, gone)])
    print(f"figures: {folder}")
    return _status([found])


def _report(options: argparse.Namespace) -> int:
    path, source = _place(options, "report.html"), Path(options.run)
    store = existing_store(options.store)
    with opened(source) as place:
        gathered = [_gathered(run, place, store) for run in place.runs]
        if place.jobs is None:
            page, missing = _page_of_run(gathered[0], place, source.name)
        else:
            page, missing = page_of_sweep([one.found for one in gathered], place, source.name)
    write_durably(path, as_html(page))
    _say(missing)
    print(f"report: {path}")
    return _status([one.found for one in gathered])


def _page_of_run(gathered: _Gathered, place: Opened, name: str) -> tuple[PageContents, list[str]]:
    """Return all that the page of a run shows, and what is missing of it."""
    found = gathered.found
    tables, missing = _own_tables(gathered)
    samples, unseen = samples_of(found.run.path, gathered.store)
    missing += unseen
    remarks = [*_remarks(gathered), *missing]
    shown = RunMaterial(found=found, recorded=read_recorded(found.run), tables=tables, remarks=remarks, samples=samples)
    return page_contents([shown], title=name, checked=checked(place, name), commands=commands(name)), missing


def _paper(options: argparse.Namespace) -> int:
    with contextlib.ExitStack() as open_bundles:
        gathered = [_for_paper(open_bundles.enter_context(_collected(run, options.store))) for run in options.runs]
        found = [one.found for one in gathered]
        _check_names([one.run.name for one in found])
        check_alike([compared.study for one in found for compared in one.studies])
        folder = output_folder(options.output)
        published = _published([one.run for one in found])
        chapters = [write_chapter("The paper beside these runs", published, [], folder / "published", _ignore)]
        # LaTeX reads no file whose name holds certain characters, so runs are numbered.
        chapters += [_chapter(one, folder / f"run{number}") for number, one in enumerate(gathered, start=1)]
    document = write_document(chapters, folder)
    print(f"document: {document}")
    pdf = make_pdf(document, shutil.which)
    engines = " or ".join(command[0] for command, _ in ENGINES)
    print(f"PDF: {pdf}" if pdf else f"no PDF: install {engines}, and run the same command again")
    return _status(found)


def _check_names(names: Sequence[str]) -> None:
    """Check that the runs have different names, which distinguish their pages."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError(
            f"{listed(twice)} twice", place="tacevo paper", expected="runs with different directory names"
        )


def _for_paper(gathered: _Gathered) -> _Gathered:
    """Keep one study of a run, and print which are passed over."""
    chosen = with_one_study(gathered.found)
    names = {compared.name for compared in gathered.found.studies} - {compared.name for compared in chosen.studies}
    _say(
        f"passed over: {name}; the paper takes the run's largest study, {chosen.studies[0].name}"
        for name in sorted(names)
    )
    return replace(gathered, found=chosen)


def _chapter(gathered: _Gathered, folder: Path) -> Chapter:
    """Write the tables and figures of a run into a folder."""
    name = gathered.found.run.name
    tables, missing = _own_tables(gathered)
    pictures, undrawn = _pictures(gathered)
    with _shown(name, len(pictures)) as on_drawn:
        chapter = write_chapter(name, tables, pictures, folder, on_drawn)
    _say([*missing, *undrawn])
    return chapter


@contextlib.contextmanager
def _collected(run: str, store: str | None) -> Iterator[_Gathered]:
    """Read a run and its studies from a directory or a bundle, and print what is missing."""
    named = existing_store(store)
    with opened(Path(run)) as place:
        gathered = _gathered(place.one_run(_ONE), place, named)
        _say(_remarks(gathered))
        yield gathered


def _gathered(run: Path, place: Opened, store: str | None) -> _Gathered:
    """Read a run and its studies, with the stores of a bundle, or with those that the user named."""
    is_bundle = place.root is not None
    used = str(place.store) if is_bundle and store is None else store
    return _Gathered(found=collect(run, None if used is None else Path(used)), store=used, is_bundle=is_bundle)


def _place(options: argparse.Namespace, name: str) -> Path:
    """Return where the results of a run are written."""
    return place_of_results(options.output, options.run, name, f"the {name} of a published run")


def _remarks(gathered: _Gathered) -> list[str]:
    """List the settings that were not sent, the studies that were left out, and how to make a first one."""
    found = gathered.found
    remarks = [*found.run.not_sent.values(), *(f"left out: {reason}" for reason in found.left_out)]
    if not found.studies and not found.left_out:
        make = f"`tacevo study run={found.run.path}` makes one, with its tables and figures"
        remarks.append(f"no finished study yet: {'it was published without a study' if gathered.is_bundle else make}")
    return remarks


def _published(runs: Sequence[Run]) -> tuple[Table, ...]:
    """Return the paper's own tables, and with runs the table that compares them."""
    return (*published_tables(), beside_published(runs)) if runs else published_tables()


def _own_tables(gathered: _Gathered) -> tuple[tuple[Table, ...], list[str]]:
    """Return the tables of a run, and why there are none of motifs: a probe is missing, or a network was edited."""
    found = gathered.found
    try:
        return tables_of(found, recall_profiles(found.run.path, gathered.store)), []
    except (CacheMissError, RunError) as error:
        return tables_of(found, None), [f"no tables of motifs: {error}"]


def _pictures(gathered: _Gathered) -> tuple[list[Picture], list[str]]:
    """List the pictures of a run, sample images first; or the reason why they are missing."""
    run = gathered.found.run
    pictures, missing = list(pictures_of(gathered.found)), list(undrawn(run))
    try:
        figure = samples_of_run(run.path, gathered.store, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return pictures, [*missing, f"no sample images: {error}"]
    caption = f"Training images of the data set ({run.name})."
    return [Picture(name=f"samples_{run.task}", caption=caption, draw=lambda: figure), *pictures], missing


def _status(collections: Sequence[Collection]) -> int:
    """Return the exit status: a study that was left out is a failed check."""
    return DIFFERENT if any(found.left_out for found in collections) else DONE


def _say(remarks: Iterable[str]) -> None:
    for remark in remarks:
        print(remark, file=sys.stderr)


def _removed(name: str) -> str:
    return f"removed {name}: its study is missing or left out"


def _ignore(name: str) -> None:
    """Report nothing of a picture."""


@contextlib.contextmanager
def _shown(words: str, total: int) -> Iterator[Callable[[str], None]]:
    """Show how many pictures are drawn, on a terminal."""
    number = itertools.count(1)
    with Progress() as view:
        yield lambda name: view.advance(words, next(number), total)


def _ablations(options: argparse.Namespace) -> int:
    store = existing_store(options.store)
    place = place_of_results(options.output, options.sweep, "ablations", "the tables and figures of a published sweep")
    found = _collected_sweep(Path(options.sweep), None if store is None else Path(store))
    folder = output_folder(place)
    tables = sweep_collection.tables_of(found)
    print("\n".join(map(as_markdown, tables)))
    write_tables(tables, folder)
    pictures = {picture.name: picture for picture in sweep_collection.pictures_of(found)}
    write_pictures(pictures.values(), folder, [".pdf"], lambda name: print(f"{name}.pdf: {pictures[name].caption}"))
    for missing in found.sweep.missing:
        print(f"missing: {missing.job.name}: {missing.reason}", file=sys.stderr)
    print(f"tables and figures: {folder}")
    return DONE


def _collected_sweep(path: Path, store: Path | None) -> sweep_collection.SweepCollection:
    """Read a sweep from a directory or a bundle, a bundle with its own stores unless others are named."""
    if not path.is_file():
        return sweep_collection.collect_sweep(path, store)
    with opened(path) as published:
        return sweep_collection.collect_sweep(published.folder, store or published.store)
