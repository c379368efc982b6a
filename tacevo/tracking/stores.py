"""MLflow stores: how one is opened, and where an experiment keeps its artifacts."""

import fcntl
from pathlib import Path

from mlflow import MlflowClient
from mlflow.exceptions import MlflowException

from tacevo.errors import RunError

_SQLITE = "sqlite:///"
#: What every SQLite database begins with; one in which nothing was made yet may be empty.
_MAGIC = b"SQLite format 3\0"


def open_store(uri: str) -> MlflowClient:
    """Open a store; a SQLite database and its folder are made where they are missing.

    Raises:
        RunError: the file is no SQLite database. (MLflow itself would try for two minutes before it said so.)
        OSError: the folder cannot be made. (Likewise.)
        MlflowException: the store cannot be opened.
    """
    database = _database(uri)
    if database is not None:
        database.parent.mkdir(parents=True, exist_ok=True)
        _make(database)
        _check(database)
    return MlflowClient(uri)


def find_or_create_experiment(client: MlflowClient, name: str) -> str:
    """Give the id of an experiment; a new one in a SQLite store keeps its artifacts beside the database."""
    found = client.get_experiment_by_name(name)
    if found is not None:
        return str(found.experiment_id)
    try:
        return client.create_experiment(name, artifact_location=_artifact_location(client.tracking_uri))
    except MlflowException:
        found = client.get_experiment_by_name(name)  # another search's mirror may have been quicker
        if found is None:
            raise
        return str(found.experiment_id)


def _make(database: Path) -> None:
    """Make a database that is missing out of sight, and then give it its name.

    MLflow creates its tables by dozens of steps. A mirror killed among them would leave a database that MLflow can
    neither use nor mend; so it leaves a hidden file, which the next mirror begins anew.
    """
    part = database.with_name(f".{database.name}.part")
    if database.exists() and not part.exists():
        return
    with part.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # another mirror may be making it
        if database.exists():
            part.unlink(missing_ok=True)
            return
        file.truncate(0)
        part.with_name(f"{part.name}-journal").unlink(missing_ok=True)
        MlflowClient(f"{_SQLITE}{part}")
        part.rename(database)


def _check(database: Path) -> None:
    with database.open("rb") as file:
        start = file.read(len(_MAGIC))
    if start not in {b"", _MAGIC}:
        raise RunError(f"{database} is no SQLite database: it begins with {start!r}; name another, or a new one")


def _artifact_location(uri: str) -> str | None:
    """Name the folder beside a SQLite database; any other store knows its own place."""
    database = _database(uri)
    return None if database is None else (database.parent / "mlartifacts").as_uri()


def _database(uri: str) -> Path | None:
    if not uri.startswith(_SQLITE):
        return None
    return Path(uri.removeprefix(_SQLITE).split("?")[0]).resolve()
