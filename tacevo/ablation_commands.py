"""The command that compares the arms of a sweep: `tacevo ablations`.

What it does is imported when it runs, so that help is quick.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tacevo.commandline import DONE, Parser, existing_store, output_folder, place_of_results

if TYPE_CHECKING:
    from analysis.sweep_collection import SweepCollection


def add_ablations(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe the command on sweeps."""
    ablations = commands.add_parser(
        "ablations",
        help="the arms of a sweep, compared: tables and figures",
        description="Compare the arms of a sweep by its finished jobs: print tables, and write them as .tex, .md and "
        ".csv, with figures as .pdf.",
    )
    ablations.add_argument("sweep", metavar="DIR", help="the folder of a sweep, or the file of a published one")
    ablations.add_argument("-o", "--output", metavar="OUT", help="where they go (default of a folder: DIR/ablations)")
    ablations.add_argument("--store", metavar="DIR", help="where the stores of the runs lie, if they were moved")
    ablations.set_defaults(
        command=_ablations, interrupted="each file that was written is whole, and the same command makes the rest"
    )


def _ablations(options: argparse.Namespace) -> int:
    from analysis.rendering import as_markdown
    from analysis.sweep_collection import pictures_of, tables_of
    from analysis.writing import write_pictures, write_tables

    store = existing_store(options.store)
    place = place_of_results(options.output, options.sweep, "ablations", "the tables and figures of a published sweep")
    found = _collected(Path(options.sweep), None if store is None else Path(store))
    folder = output_folder(place)
    tables = tables_of(found)
    print("\n".join(map(as_markdown, tables)))
    write_tables(tables, folder)
    pictures = {picture.name: picture for picture in pictures_of(found)}
    write_pictures(pictures.values(), folder, [".pdf"], lambda name: print(f"{name}.pdf: {pictures[name].caption}"))
    for missing in found.sweep.missing:
        print(f"missing: {missing.job.name}: {missing.reason}", file=sys.stderr)
    print(f"tables and figures: {folder}")
    return DONE


def _collected(path: Path, store: Path | None) -> "SweepCollection":
    """Read a sweep from its folder or a bundle; from a bundle's own stores, unless others are named."""
    from analysis.sweep_collection import collect_sweep
    from tacevo.opening import opened
    from tacevo.sweepstatus import recorded_hash

    if not path.is_file():
        return collect_sweep(path, store, recorded_hash)
    with opened(path) as published:
        return collect_sweep(published.folder, store or published.store, recorded_hash)
