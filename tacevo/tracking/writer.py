"""Writes one search into an MLflow store, through the public client.

What it promises: what stands in the store already is not written again, and a candidate's run that was left
unfinished is replaced. What it does not: two writers of one search at the same time; `mirror` sees to that.
"""

import fcntl
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Metric, Param, Run
from mlflow.exceptions import MlflowException

from tacevo.tracking.entries import Measure

#: Tags that name a search, a candidate within it, and the digest of a finished search.
RUN_TAG = "tacevo.run"
CANDIDATE_TAG = "tacevo.candidate"
DIGEST_TAG = "tacevo.digest"

#: The tag by which MLflow nests runs.
_PARENT_TAG = "mlflow.parentRunId"
_SQLITE = "sqlite:///"
# What MLflow takes in one batch: 100 params, 1,000 values in all.
_PARAMS_PER_BATCH = 100
_METRICS_PER_BATCH = 900


def open_store(uri: str) -> MlflowClient:
    """Open a store; a SQLite database and its folder are made where they are missing.

    Raises:
        OSError: the folder cannot be made. (MLflow itself would try for two minutes before it said so.)
        MlflowException: the store cannot be opened.
    """
    database = _database(uri)
    if database is not None:
        database.parent.mkdir(parents=True, exist_ok=True)
        _make(database)
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


class SearchWriter:
    """A search's parent run, found by its tag or created, and what the store holds of the search already.

    Args:
        client: the store.
        experiment: the experiment's id.
        key: names the search; a string without quotes.
        name: what a new parent run is called.
    """

    def __init__(self, client: MlflowClient, experiment: str, *, key: str, name: str) -> None:
        self._client = client
        self._experiment = experiment
        found = client.search_runs([experiment], f"tags.`{RUN_TAG}` = '{key}'", max_results=1)
        parent = found[0] if found else client.create_run(experiment, run_name=name, tags={RUN_TAG: key})
        self._parent: str = parent.info.run_id
        self._params = frozenset(parent.data.params)
        self._steps = {metric: self._steps_of(metric) for metric in parent.data.metrics}
        self._candidates = frozenset(self._finished_candidates()) if found else frozenset()
        if found:
            client.update_run(self._parent, status="RUNNING")
        if DIGEST_TAG in parent.data.tags:
            client.delete_tag(self._parent, DIGEST_TAG)  # it was the digest of a shorter run, perhaps

    def write_params(self, params: Mapping[str, str]) -> None:
        """Write the search's params; MLflow lets none change, so one that stands already stays as it is."""
        self._log(self._parent, {key: params[key] for key in params.keys() - self._params}, ())

    def write_generation(self, measures: Sequence[Measure]) -> None:
        """Write a generation's metrics on the parent run."""
        new = [measure for measure in measures if measure.step not in self._steps.get(measure.key, ())]
        self._log(self._parent, {}, new)

    def write_candidate(
        self, name: str, params: Mapping[str, str], measures: Sequence[Measure], source: Path, *, failed: bool
    ) -> None:
        """Write a candidate as a nested run.

        Args:
            name: the candidate's id.
            params: params by name.
            measures: its metrics.
            source: the file to keep as its artifact, where it exists.
            failed: whether the candidate was turned away.
        """
        if name in self._candidates:
            return
        tags = {_PARENT_TAG: self._parent, CANDIDATE_TAG: name}
        run: str = self._client.create_run(self._experiment, run_name=name, tags=tags).info.run_id
        self._log(run, params, measures)
        if source.exists():
            self._client.log_artifact(run, str(source))
        self._client.set_terminated(run, "FAILED" if failed else "FINISHED")

    def end(self, digest: str | None) -> None:
        """End the parent run: finished with a digest, or killed without one."""
        if digest is not None:
            self._client.set_tag(self._parent, DIGEST_TAG, digest)
        self._client.set_terminated(self._parent, "KILLED" if digest is None else "FINISHED")

    def _log(self, run: str, params: Mapping[str, str], measures: Sequence[Measure]) -> None:
        now = time.time_ns() // 1_000_000
        metrics = [Metric(measure.key, measure.value, now, measure.step) for measure in measures]
        texts = [Param(key, params[key]) for key in sorted(params)]
        while metrics or texts:
            self._client.log_batch(run, metrics[:_METRICS_PER_BATCH], texts[:_PARAMS_PER_BATCH])
            metrics, texts = metrics[_METRICS_PER_BATCH:], texts[_PARAMS_PER_BATCH:]

    def _steps_of(self, metric: str) -> frozenset[int]:
        return frozenset(point.step for point in self._client.get_metric_history(self._parent, metric))

    def _finished_candidates(self) -> Iterator[str]:
        """Give the candidates that stand whole in the store, and delete the others' runs."""
        for run in self._nested_runs():
            if run.info.status in {"FINISHED", "FAILED"}:
                yield run.data.tags[CANDIDATE_TAG]
            else:
                self._client.delete_run(run.info.run_id)

    def _nested_runs(self) -> list[Run]:
        wanted = f"tags.`{_PARENT_TAG}` = '{self._parent}'"
        runs: list[Run] = []
        token = None
        while True:
            page = self._client.search_runs([self._experiment], wanted, page_token=token)
            runs.extend(page)
            token = page.token
            if not token:
                return runs


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


def _artifact_location(uri: str) -> str | None:
    """Name the folder beside a SQLite database; any other store knows its own place."""
    database = _database(uri)
    return None if database is None else (database.parent / "mlartifacts").as_uri()


def _database(uri: str) -> Path | None:
    if not uri.startswith(_SQLITE):
        return None
    return Path(uri.removeprefix(_SQLITE).split("?")[0]).resolve()
