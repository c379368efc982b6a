"""What MLflow finds around it: it reads its environment while it is imported."""

import gc
import os

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
