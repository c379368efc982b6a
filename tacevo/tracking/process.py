"""Start and end the mirror's process; MLflow is never imported here.

What it promises: a mirror that is slow, fails or is missing neither stops nor changes a search; the search only warns.
A mirror outlives a killed search by the time that it takes to write what was committed.
"""

import gc
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tacevo.errors import ConfigError
from tacevo.tracking.params import URI_VARIABLE, shown_address


class Mirror:
    """A process that mirrors a run while it is written.

    Args:
        run_dir: the run directory, which holds `run.json` when the mirror starts; the process logs to
            `tracking.log` there.
        uri: the MLflow tracking URI; empty for the one in MLFLOW_TRACKING_URI.
        more: directories of finished runs, which are mirrored after it.
    """

    def __init__(self, run_dir: Path, *, uri: str, experiment: str, more: Sequence[Path] = ()) -> None:
        self._run_dir, self._more = run_dir, more
        self._uri = uri
        self._experiment = experiment
        self._log = run_dir / "tracking.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._failure = "it was not started"

    def start(self) -> None:
        """Start the process; a failure to start is kept for `finish`."""
        runs = map(str, (self._run_dir, *self._more))
        command = [sys.executable, "-P", "-m", "tacevo.tracking", *runs, "--follow"]
        try:
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(
                    [*command, "--uri", self._uri, "--experiment", self._experiment],
                    env={**os.environ, "PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)},
                    stdin=subprocess.PIPE,
                    stdout=log,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,  # Ctrl-C is the search's to handle
                )
        except OSError as error:
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
        runs = (self._run_dir, *self._more)
        place = shlex.quote(os.path.commonpath(runs))  # of several, the directory that they lie in
        what = "the runs themselves are" if self._more else "the run itself is"
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


_QUIET = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",  # it has two lines for each run on a server
}

#: A server that is started again, which takes seconds, is waited for: a minute in all, where MLflow itself waits four.
_PATIENCE = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "5", "MLFLOW_HTTP_REQUEST_TIMEOUT": "10"}


def prepare() -> None:
    """Set the environment of this process for MLflow; to be called before it is imported."""
    gc.set_threshold(100_000)  # MLflow's import makes many lasting objects; looking through them was a sixth of it
    os.environ.update(_QUIET)
    for name, value in _PATIENCE.items():
        os.environ.setdefault(name, value)  # the user's own choice comes first


def store_address(uri: str) -> str:
    """Return a tracking URI, or where it is empty the one that MLFLOW_TRACKING_URI holds.

    Raises:
        ConfigError: both are empty.
    """
    address = uri or os.environ.get(URI_VARIABLE, "")
    if not address:
        raise ConfigError(
            "nothing",
            place="tracking.uri",
            expected=f"the address of an MLflow store, there or in {URI_VARIABLE}",
            remedy="set one of the two, or give `tacevo track --uri`, e.g. --uri sqlite:///mlflow.db",
        )
    return address


def without_address(text: str) -> str:
    """Replace the address that MLFLOW_TRACKING_URI holds, which may have a password, by the variable's name."""
    address = os.environ.get(URI_VARIABLE)
    return text.replace(address, f"${URI_VARIABLE}") if address else text
