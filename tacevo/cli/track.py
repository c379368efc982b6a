"""The command `tacevo track`."""

import argparse
from functools import partial
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser, tell
from tacevo.environment import as_typed
from tacevo.runs.progress import Progress
from tacevo.text import counted
from tacevo.tracking.backfill import track
from tacevo.tracking.params import viewing


def add_track(parser: Parser) -> None:
    """Describe `tacevo track`."""
    parser.description = (
        "Mirror a run directory into MLflow, or those of a sweep, or all below a directory. A second time writes "
        "nothing twice. The exit status is 1 if a run of several could not be written."
    )
    parser.add_argument(
        "directory", metavar="DIR", help="the directory of a run, of a sweep, or one that contains such"
    )
    parser.add_argument(
        "--uri", default="", help="MLflow tracking URI (default: each run's own, else MLFLOW_TRACKING_URI)"
    )
    parser.set_defaults(command=_track, interrupted="what is in MLflow stays, and the same command writes the rest")


def _track(options: argparse.Namespace) -> int:
    with Progress() as view:
        done, failed = track(Path(options.directory), options.uri, partial(view.advance, "runs"))
    for reason in failed:
        tell(f"failed: {reason}", error=True)
    for uri, number in done.items():
        tell(f"{counted(number, 'run')} of {options.directory} in MLflow: {viewing(uri, as_typed('mlflow'))}")
    return DIFFERENT if failed else DONE
