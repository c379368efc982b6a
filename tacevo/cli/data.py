"""The commands `tacevo data ...`."""

import json
from collections.abc import Sequence

from rich.console import Console

from tacevo.cli.common import DIFFERENT, DONE, tell
from tacevo.records import to_json
from tacevo.runs.data_check import inspect_data, show, simulate
from tacevo.runs.data_report import report


def check_data(overrides: Sequence[str], sheet: str | None, *, as_json: bool) -> int:
    """Check a data set, and draw a contact sheet of it into a file."""
    inspection = inspect_data(overrides, sheet, Console(stderr=True))
    tell(json.dumps(to_json(inspection), indent=2) if as_json else report(inspection))
    return DIFFERENT if inspection.leaks else DONE


def show_data(overrides: Sequence[str], figure: str, width: str) -> int:
    """Draw a few samples into a file."""
    tell(f"look: {show(overrides, figure, width, Console(stderr=True))}")
    return DONE


def simulate_data(overrides: Sequence[str]) -> int:
    """Write a simulated data set."""
    tell(simulate(overrides, Console(stderr=True)))
    return DONE
