"""The commands `tacevo figures` and `tacevo ablations`."""

import argparse
import contextlib
import itertools
import shlex
from collections.abc import Callable, Iterator

from rich.console import Console

from analysis.report.figure_list import Picture, pictures_of, sweep_pictures, undrawn, write_pictures
from analysis.report.writing import for_paper, left_of_studies, write_tables
from analysis.sweeps.metrics import TESTS
from analysis.tables.rendering import as_markdown
from tacevo.api.opening import open as open_path
from tacevo.api.runs import Run
from tacevo.api.sweeps import Sweep
from tacevo.cli.common import DONE, RUNS, Parser, existing_store, output_directory, place_of_results
from tacevo.cli.tables import add_places, add_store, open_all, places_of, remarks_of, say, status_of
from tacevo.environment import as_typed
from tacevo.errors import ConfigError, DataError, RunError
from tacevo.runs.data_check import samples_of_run
from tacevo.runs.progress import Progress

_FORMATS = ("pdf", "svg", "png")


def add_figures(parser: Parser) -> None:
    """Describe `tacevo figures`."""
    parser.description = "Draw every figure of finished runs and their studies, and of sweeps."
    parser.add_argument("runs", metavar="RUN", nargs="+", help=RUNS)
    parser.add_argument(
        "--format", nargs="+", choices=_FORMATS, default=_FORMATS, help="of the files (default: all three)"
    )
    add_places(parser, "figures")
    parser.set_defaults(command=_figures)


def add_ablations(parser: Parser) -> None:
    """Describe `tacevo ablations`."""
    parser.description = (
        "Compare the arms of a sweep by its finished jobs: print a table of them, and write all as .tex, .md and .csv, "
        "with figures as .pdf."
    )
    parser.add_argument("sweep", metavar="DIR", help="the directory or bundle of a sweep")
    parser.add_argument(
        "-o", "--output", metavar="OUT", help="where to write them (default for a directory: DIR/ablations)"
    )
    parser.add_argument(
        "--reference", metavar="ARM", help="the arm to compare with (default: the one that the sweep states, or none)"
    )
    add_store(parser)
    parser.set_defaults(command=_ablations)


def _figures(options: argparse.Namespace) -> int:
    places = places_of(options, "figures")
    opened = open_all(options.runs, options.store)
    endings = [f".{name}" for name in dict.fromkeys(options.format)]
    for one, place in zip(opened, places, strict=True):
        say(remarks_of(one))
        directory = output_directory(place)
        pictures, missing = drawable(one)
        with progress_of("figures", len(pictures)) as on_drawn:
            write_pictures(pictures, directory, endings, on_drawn)
        current = {picture.name for picture in pictures}
        say([*missing, *left_of_studies(directory, current, [f".{name}" for name in _FORMATS])])
        print(f"figures: {directory}")
    return max(map(status_of, opened))


def drawable(one: Run | Sweep) -> tuple[list[Picture], list[str]]:
    """List the figures of a run, sample images first, or of a sweep; and the reasons why others are missing."""
    if isinstance(one, Sweep):
        return list(sweep_pictures(one.collection())), []
    run = one.recorded
    pictures, missing = list(pictures_of(one.collection)), list(undrawn(run))
    try:
        figure = samples_of_run(run.config, run.facts, Console(stderr=True))
    except (ConfigError, DataError) as error:
        return pictures, [*missing, f"no sample images: {error}"]
    caption = f"Training images of the data set ({run.name})."
    return [Picture(name="samples", caption=caption, draw=lambda: figure), *pictures], missing


@contextlib.contextmanager
def progress_of(words: str, total: int) -> Iterator[Callable[[str], None]]:
    """Show how many pictures are drawn, on a terminal."""
    number = itertools.count(1)
    with Progress() as view:
        yield lambda name: view.advance(words, next(number), total)


def _ablations(options: argparse.Namespace) -> int:
    place = place_of_results(options.output, options.sweep, "ablations", "the tables and figures of a published sweep")
    sweep = open_path(options.sweep, store=existing_store(options.store))
    if isinstance(sweep, Run):
        raise RunError("one run", place=options.sweep, expected="a sweep", remedy="`tacevo tables` has those of a run")
    collected = sweep.collection(options.reference)
    directory = output_directory(place)
    tables, _ = sweep.all_tables(options.reference)
    write_tables(tables, directory)
    print("\n".join(map(as_markdown, for_paper(tables))))
    pictures = {picture.name: picture for picture in sweep_pictures(collected)}
    write_pictures(pictures.values(), directory, [".pdf"], lambda name: print(f"{name}.pdf: {pictures[name].caption}"))
    say(sweep.left_out)
    if collected.found.primary in TESTS.values() and collected.sweep.terms.retraining is None:
        print(f"next:   {as_typed('tacevo')} study sweep={shlex.quote(options.sweep)}")
    print(f"tables and figures: {directory}")
    return DONE
