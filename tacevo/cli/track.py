"""The command `tacevo track`; what it does is imported when it runs, so that help is quick."""

import argparse
import sys
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser


def add_track(commands: "argparse._SubParsersAction[Parser]") -> None:
    """Describe `tacevo track`."""
    track = commands.add_parser(
        "track",
        help="write the ledgers of runs into MLflow, or what is missing there",
        description="Mirror a run directory into MLflow, or those of a sweep, or all below a directory. A second time "
        "writes nothing twice. The exit status is 1 if a run of several could not be written.",
    )
    track.add_argument("directory", metavar="DIR", help="the directory of a run, of a sweep, or one that contains such")
    track.add_argument(
        "--uri", default="", help="MLflow tracking URI (default: each run's own, else MLFLOW_TRACKING_URI)"
    )
    track.set_defaults(command=_track, interrupted="what is in MLflow stays, and the same command writes the rest")


def _track(options: argparse.Namespace) -> int:
    from rich.console import Console

    from tacevo.runs.progress import make_track_view
    from tacevo.text import counted
    from tacevo.tracking.backfill import track
    from tacevo.tracking.entries import viewing

    with make_track_view(Console(file=sys.stderr)) as view:
        tracked = track(Path(options.directory), options.uri, view.tracked)
    for reason in tracked.failed:
        print(f"failed: {reason}", file=sys.stderr)
    for uri, number in tracked.done.items():
        print(f"{counted(number, 'run')} of {options.directory} in MLflow: {viewing(uri)}")
    return DIFFERENT if tracked.failed else DONE
