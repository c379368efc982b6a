"""The command `tacevo track`; what it does is imported when it runs, so that help is quick."""

import argparse
import sys
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser


def add_track(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo track`."""
    track = commands.add_parser(
        "track",
        help="write the ledgers of runs into MLflow, or what is missing of them there",
        description="Mirror a run directory into MLflow, or those of a sweep, or all below a folder. Doing it twice "
        "writes nothing twice. The exit status is 1 where a run of several could not be written.",
    )
    track.add_argument("folder", metavar="DIR", help="the folder of a run, of a sweep, or with such below it")
    track.add_argument("--uri", help="MLflow tracking URI (default: each run's own)")
    track.set_defaults(command=_track, interrupted="what is in MLflow stays, and the same command writes the rest")


def _track(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.runs.progress import make_track_view
    from tacevo.text import counted
    from tacevo.tracking.backfill import track

    folder = Path(options.folder)
    with make_track_view(Console(file=sys.stderr)) as view:
        tracked = track(folder, options.uri, view.tracked)
    for reason in tracked.failed:
        print(f"failed: {reason}", file=sys.stderr)
    for look, number in tracked.views:
        print(f"{counted(number, 'run')} of {folder} in MLflow: {look}")
    return DIFFERENT if tracked.failed else DONE
