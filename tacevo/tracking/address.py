"""The address of an MLflow store, which may hold a password, and what MLflow needs of the process that imports it."""

import contextlib
import gc
import os
import shlex
from collections.abc import Iterator

from tacevo.errors import ConfigError, RunError, TacevoError

#: The environment variable in which MLflow itself looks for a tracking URI.
URI_VARIABLE = "MLFLOW_TRACKING_URI"

_QUIET = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "DO_NOT_TRACK": "true",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",  # it has two lines for each run on a server
}

#: A server that is started again, which takes seconds, is waited for: a minute in all, where MLflow itself waits four.
_PATIENCE = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "5", "MLFLOW_HTTP_REQUEST_TIMEOUT": "10"}


class MlflowError(RunError):
    """MLflow failed, and would fail with the next run."""


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


def shown_address(uri: str) -> str:
    """Return a tracking URI, or the name of the environment variable that holds it."""
    return uri or f"${URI_VARIABLE}"


def without_address(text: str) -> str:
    """Replace the address that MLFLOW_TRACKING_URI holds, which may have a password, by the variable's name."""
    address = os.environ.get(URI_VARIABLE)
    return text.replace(address, f"${URI_VARIABLE}") if address else text


def viewing(uri: str, mlflow: str) -> str:
    """Return how to look at a store: a server's own page, or a command that serves one.

    An empty URI is the one in MLFLOW_TRACKING_URI; `mlflow` is how that command is spelt here.
    """
    if uri.startswith(("http://", "https://")):
        return uri
    address = shlex.quote(uri) if uri else f'"${URI_VARIABLE}"'
    return f"{mlflow} ui --backend-store-uri {address}"


@contextlib.contextmanager
def told(place: str, uri: str, remedy: str) -> Iterator[None]:
    """Raise what is not an error of tacevo, of whatever class a driver has, as an `MlflowError` of one line.

    `place` is what was to be written, `remedy` what to do once the store can be used; an empty URI is that of
    MLFLOW_TRACKING_URI.
    """
    try:
        yield
    except TacevoError:
        raise
    except Exception as error:
        reason = without_address(str(error)).partition("\n")[0]
        library = (error.name or "").partition(".")[0] if isinstance(error, ImportError) else "tacevo"
        lacks = library not in {"tacevo", "analysis"}
        driver = "install the database driver that this address needs, then " if lacks else ""
        raise MlflowError(
            f"{type(error).__name__}: {reason}",
            place=f"{place} into {shown_address(uri)}",
            expected="an MLflow store that can be written",
            remedy=f"{driver}{remedy}",
        ) from error
