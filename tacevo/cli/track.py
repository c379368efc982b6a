"""The command `tacevo track`."""

from functools import partial
from pathlib import Path

from tacevo.cli.common import DIFFERENT, DONE, tell
from tacevo.environment import as_typed
from tacevo.runs.progress import Progress
from tacevo.text import counted
from tacevo.tracking.address import viewing
from tacevo.tracking.track import track


def run_track(directory: str, uri: str) -> int:
    """Mirror the runs in a directory."""
    with Progress() as view:
        done, failed = track(Path(directory), uri, partial(view.advance, "runs"))
    for reason in failed:
        tell(f"failed: {reason}", error=True)
    for store, number in done.items():
        tell(f"{counted(number, 'run')} of {directory} in MLflow: {viewing(store, as_typed('mlflow'))}")
    return DIFFERENT if failed else DONE
