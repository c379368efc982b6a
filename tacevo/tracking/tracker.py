"""The tracker that mirrors runs into MLflow by a process of its own; MLflow itself is not imported here."""

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacevo.environment import as_typed
from tacevo.tracking.address import shown_address, viewing


@dataclass(frozen=True, slots=True, kw_only=True)
class MLflow:
    """Mirrors runs into an MLflow store (see `tacevo.parts.tracker.Tracker`)."""

    #: The store's address; empty for the one in MLFLOW_TRACKING_URI.
    uri: str
    experiment: str

    def mirror(self, runs: Sequence[Path]) -> "Mirror":
        """Start the process that mirrors runs, one after the other."""
        return Mirror(runs, uri=self.uri, experiment=self.experiment)

    def viewing(self) -> str:
        """Say which command or page shows the store."""
        return f"MLflow: {viewing(self.uri, as_typed('mlflow'))}"


class Mirror:
    """The process that mirrors runs, of which the first may still be written; it is started at once.

    Args:
        runs: directories, the first of which holds `run.json` already; the process logs to `tracking.log` there.
        uri: the MLflow tracking URI; empty for the one in MLFLOW_TRACKING_URI.
        experiment: the name of the MLflow experiment.
    """

    def __init__(self, runs: Sequence[Path], *, uri: str, experiment: str) -> None:
        self._runs, self._uri = runs, uri
        self._log = runs[0] / "tracking.log"
        self._process: subprocess.Popen[bytes] | None = None
        command = [sys.executable, "-P", "-m", "tacevo.tracking", *map(str, runs), "--follow"]
        try:
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(
                    [*command, "--uri", uri, "--experiment", experiment],
                    env={**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)},
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C is the search's to handle
                )
        except OSError as error:  # is told by `finish`
            self._failure = str(error)

    def finish(self, timeout: float | None) -> str | None:
        """End the input of the process: no more lines come. Wait so many seconds for its end, or as long as it takes.

        Returns:
            None, or one line that warns the user: the mirror failed, or it is not done and continues by itself.
        """
        if self._process is None:
            return self._failed(self._failure)
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            status = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return f"the MLflow mirror to {shown_address(self._uri)} still writes, and continues by itself"
        if status == 0:
            return None
        return self._failed(self._last_line() if status == 1 else f"its exit status was {status}")

    def _failed(self, why: str) -> str:
        log = f"see {self._log}, then " if self._log.exists() and self._log.stat().st_size else ""
        place = shlex.quote(os.path.commonpath(self._runs))  # of several, the directory that they lie in
        what = "the runs themselves are" if len(self._runs) > 1 else "the run itself is"
        return (
            f"the MLflow mirror to {shown_address(self._uri)} failed: {why}; {what} not affected; "
            f"{log}`tacevo track {place}` writes what is missing"
        )

    def _last_line(self) -> str:
        try:
            lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError as error:
            return str(error)
        return lines[-1] if lines else "its log is empty"
