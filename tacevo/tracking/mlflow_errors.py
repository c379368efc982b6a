"""What MLflow raises, told in one line without addresses."""

import contextlib
from collections.abc import Iterator

from tacevo.errors import RunError, TacevoError
from tacevo.tracking.params import shown_address
from tacevo.tracking.process import without_address


class MlflowError(RunError):
    """MLflow failed, and would fail with the next run."""


@contextlib.contextmanager
def told(place: str, uri: str, remedy: str) -> Iterator[None]:
    """Raise what is not an error of tacevo, of whatever class a driver has, as an `MlflowError`.

    `place` is what was to be written, `remedy` what to do once the store can be used; an empty URI is that of
    MLFLOW_TRACKING_URI.
    """
    try:
        yield
    except TacevoError:
        raise
    except Exception as error:
        reason = without_address(str(error)).partition("\n")[0]
        driver = "install the database driver that this address needs, then " if isinstance(error, ImportError) else ""
        raise MlflowError(
            f"{type(error).__name__}: {reason}",
            place=f"{place} into {shown_address(uri)}",
            expected="an MLflow store that can be written",
            remedy=f"{driver}{remedy}",
        ) from error
