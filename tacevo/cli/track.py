"""The command `tacevo track`."""

import argparse
import sys
from functools import partial
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, Parser
from tacevo.runs.progress import Progress
from tacevo.text import counted
from tacevo.tracking.backfill import track


def add_track(parser: Parser) -> None:
    """Describe `tacevo track`."""
    parser.description = (
        "Mirror a run directory into MLflow, or those of a sweep, or all below a directory. Doing it twice writes "
        "nothing twice. The exit status is 1 if one of several runs could not be written."
    )
    parser.add_argument("folder", metavar="DIR", help="the directory of a run or a sweep, or one that holds such")
    parser.add_argument("--uri", help="MLflow tracking URI (default: each run's own)")
    parser.set_defaults(command=_track, interrupted="what is in MLflow stays, and the same command writes the rest")


def _track(options: argparse.Namespace) -> int:
    folder = Path(options.folder)
    with Progress() as view:
        tracked = track(folder, options.uri, partial(view.advance, "runs"))
    for reason in tracked.failed:
        print(f"failed: {reason}", file=sys.stderr)
    for look, number in tracked.views:
        print(f"{counted(number, 'run')} of {folder} in MLflow: {look}")
    return DIFFERENT if tracked.failed else DONE
