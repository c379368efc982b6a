"""An MLflow store through its public client: what stands in it is found, what it lacks is written.

What it promises: what stands there already is not written again, and a nested run that was left unfinished is written
anew. Two processes that write one search at the same time are kept apart by the directory that they read (`alone`).
"""

import contextlib
import getpass
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, LifecycleStage, Metric, Param, Run
from mlflow.exceptions import MlflowException

from tacevo.errors import RunError
from tacevo.storage.files import flock
from tacevo.tracking.shown import CANDIDATE_TAG, STUDY_TAG, Point, Shown, note

#: The tags by which MLflow nests runs, says who wrote one, and shows a description, in Markdown.
PARENT_TAG, _USER_TAG, NOTE_TAG = "mlflow.parentRunId", "mlflow.user", "mlflow.note.content"

#: The tags of a search: what it is found by, and the digest of a finished one.
RUN_TAG, DIGEST_TAG = "tacevo.run", "tacevo.digest"

#: The tag of a nested run with the hash of the line that it comes from.
_LINE_TAG = "tacevo.line"

#: The tag by which MLflow's pages open an experiment: on its runs, and not on the traces of an application.
_KIND = {"mlflow.experimentKind": "custom_model_development"}

# What MLflow takes in one batch: 100 params, 1,000 values in all.
_PARAMS_PER_BATCH = 100

_METRICS_PER_BATCH = 900

_SQLITE = "sqlite:///"

#: What the report page is called, in the run directory and among the artifacts.
_PAGE = "report.html"


@dataclass(frozen=True, slots=True)
class Store:
    """An experiment of a store."""

    client: MlflowClient
    #: The experiment's id.
    experiment: str

    @classmethod
    def open(cls, uri: str, experiment: str) -> "Store":
        """Open a store and an experiment in it, which are made where they are missing.

        A SQLite database is made with its directory, and keeps its artifacts beside it.

        Raises:
            RunError: the experiment was deleted, which in MLflow hides it and keeps its name.
            OSError: the directory of a database cannot be made. (MLflow itself would try for two minutes.)
            MlflowException: the store cannot be opened, or the experiment not be created.
        """
        database = _database(uri)
        if database is not None:
            database.parent.mkdir(parents=True, exist_ok=True)
            _create(database)
        client = MlflowClient(uri)
        return cls(client, find_or_create_experiment(client, experiment))

    def find_or_create(self, *, tag: str, key: str, name: str) -> Run:
        """Return the run whose `tag` is `key`, a text without quotes; a new one is called `name`."""
        known = next(self.tagged(tag, key), None)
        return known or self.client.create_run(self.experiment, run_name=name, tags={tag: key, **_user_tags()})

    def tagged(self, tag: str, value: str) -> Iterator[Run]:
        """Yield the runs that have a tag; neither text may have quotes."""
        token = None
        while True:
            page = self.client.search_runs([self.experiment], f"tags.`{tag}` = '{value}'", page_token=token)
            yield from page
            token = page.token
            if not token:
                return

    def log(self, run: str, params: Mapping[str, str], points: Iterable[Point]) -> None:
        """Write params and metrics of a run, in as few requests as MLflow allows."""
        now = time.time_ns() // 1_000_000
        metrics = [Metric(key, value, now, step) for key, value, step in points]
        texts = [Param(key, params[key]) for key in sorted(params)]
        while metrics or texts:
            self.client.log_batch(run, metrics[:_METRICS_PER_BATCH], texts[:_PARAMS_PER_BATCH])
            metrics, texts = metrics[_METRICS_PER_BATCH:], texts[_PARAMS_PER_BATCH:]


class Search:
    """The run of a search, found or created, which is then RUNNING; and what stands there of it.

    Args:
        key: what it is found by, a text without quotes.
        name: what a new one is called.
        tags: those of the run.
        source: tags of the run and of every nested one that name the code.
    """

    def __init__(
        self, store: Store, *, key: str, name: str, tags: Mapping[str, str], source: Mapping[str, str]
    ) -> None:
        self._store, self._source = store, source
        self._run = store.find_or_create(tag=RUN_TAG, key=key, name=name)
        self._id: str = self._run.info.run_id
        self._nested = self._finished_runs()
        self._steps = dict[str, set[int]]()
        client, standing = store.client, self._run.data.tags
        for tag, value in {**tags, **source}.items():
            if standing.get(tag) != value:
                client.set_tag(self._id, tag, value)
        client.update_run(self._id, status="RUNNING")
        if DIGEST_TAG in standing:
            client.delete_tag(self._id, DIGEST_TAG)  # a longer run has another one

    def write_params(self, params: Mapping[str, str]) -> None:
        """Write params; MLflow lets none change, so one that stands already stays as it is."""
        self._store.log(self._id, {key: params[key] for key in params.keys() - self._run.data.params}, ())

    def write_data(self, data: Mapping[str, str]) -> None:
        """Write the data set that the search trains on as an input of its run; MLflow keeps an equal one once."""
        context = InputTag(key="mlflow.data.context", value="training")
        self._store.client.log_inputs(self._id, [DatasetInput(Dataset(**data), [context])])

    def steps(self, metric: str) -> set[int]:
        """Return the steps at which the search has a metric."""
        if metric not in self._steps:
            has_it = metric in self._run.data.metrics
            history = self._store.client.get_metric_history(self._id, metric) if has_it else ()
            self._steps[metric] = {point.step for point in history}
        return self._steps[metric]

    def add_points(self, points: Sequence[Point], known_by: str) -> None:
        """Write metrics, but for those at steps at which the metric `known_by` stands already."""
        known = self.steps(known_by)
        lacking = [point for point in points if point[2] not in known]
        self._store.log(self._id, {}, lacking)
        known.update(step for _, _, step in lacking)

    def lacks(self, name: str, line: str) -> bool:
        """Return whether the store lacks a candidate or study of a name; the hash of its line tells it apart.

        Raises:
            RunError: the store holds another one of that name.
        """
        if self._nested.get(name, line) != line:
            raise RunError(
                f"those of another search of the same settings and name, from {name} on",
                place=f"MLflow run {self._id}",
                expected="the candidates and studies of this run",
                remedy="delete that run in MLflow, or rename the run directory, and run `tacevo track` again",
            )
        return name not in self._nested

    def add(self, shown: Shown) -> None:
        """Write a candidate or a study as a nested run, where it is lacking; raises as `lacks`."""
        if not self.lacks(shown.name, shown.line):
            return
        client = self._store.client
        named = {PARENT_TAG: self._id, shown.tag: shown.name, _LINE_TAG: shown.line}
        tags = {**named, **self._source, **shown.tags, **_user_tags()}
        run: str = client.create_run(self._store.experiment, run_name=shown.name, tags=tags).info.run_id
        self._store.log(run, shown.params, shown.points)
        for file, text in shown.files.items():
            client.log_text(run, text, file)
        client.set_terminated(run, "FAILED" if shown.failed else "FINISHED")  # from now on it counts

    def finish(self, digest: str, run_dir: Path) -> None:
        """End the run as finished, with its digest, its summary as a description, and what there is to read.

        That is the summary and the report page of the run directory, unless the run has ended since. Of a digest that
        stands there already, only what is missing is written, and a page that has become another one, as after a study.
        """
        client, tags = self._store.client, self._run.data.tags
        is_new = tags.get(DIGEST_TAG) != digest
        standing = {} if is_new else {file.path: file.file_size for file in client.list_artifacts(self._id)}
        summary, page = run_dir / "summary.md", run_dir / _PAGE
        if summary.exists():
            if is_new or NOTE_TAG not in tags:
                client.set_tag(self._id, NOTE_TAG, note(summary.read_text(encoding="utf-8"), summary.name))
            if summary.name not in standing:
                client.log_artifact(self._id, str(summary))
            is_current = page.exists() and page.stat().st_mtime >= summary.stat().st_mtime
            if is_current and page.stat().st_size != standing.get(_PAGE):
                client.log_artifact(self._id, str(page))
        client.set_tag(self._id, DIGEST_TAG, digest)
        client.set_terminated(self._id, "FINISHED")

    def stop(self) -> None:
        """End the run as killed."""
        self._store.client.set_terminated(self._id, "KILLED")

    def _finished_runs(self) -> dict[str, str]:
        """Return the hashes of the candidates and studies that the store holds whole; delete the runs of others.

        What else is nested there, such as a model or a user's own run, is left alone.
        """
        known: dict[str, str] = {}
        for run in list(self._store.tagged(PARENT_TAG, self._id)):
            name = run.data.tags.get(CANDIDATE_TAG) or run.data.tags.get(STUDY_TAG)
            if name is None:
                continue
            if run.info.status == "RUNNING":
                self._store.client.delete_run(run.info.run_id)
            else:
                known[name] = run.data.tags[_LINE_TAG]
        return known


def find_or_create_experiment(client: MlflowClient, name: str) -> str:
    """Return the id of an experiment (see `Store.open`)."""
    known = client.get_experiment_by_name(name)
    if known is None:
        database = _database(client.tracking_uri)  # any other store knows its own place
        place = None if database is None else (database.parent / "mlartifacts").as_uri()
        try:
            return client.create_experiment(name, artifact_location=place, tags=_KIND)
        except MlflowException:
            known = client.get_experiment_by_name(name)  # the mirror of another search may have created it
            if known is None:
                raise
    elif known.lifecycle_stage != LifecycleStage.ACTIVE:
        raise RunError(
            "one that was deleted",
            place=f"MLflow experiment {name}",
            expected="an active one",
            remedy=f"restore it (`mlflow experiments restore --experiment-id {known.experiment_id}`), then "
            "`tacevo track` writes what is missing; or set tracking.experiment=NAME",
        )
    return str(known.experiment_id)


def _user_tags() -> dict[str, str]:
    """Return the tag of who writes; none where this machine does not know the user."""
    with contextlib.suppress(OSError, KeyError, ImportError):  # of releases of Python
        return {_USER_TAG: getpass.getuser()}
    return {}


def _create(database: Path) -> None:
    """Create a missing database under a hidden name, and then rename it.

    MLflow creates its tables in dozens of steps. A mirror that is killed among them would leave a database that MLflow
    can neither use nor repair; so it leaves a hidden file, which the next mirror replaces.
    """
    part = database.with_name(f".{database.name}.part")
    if database.exists() and not part.exists():
        return
    with part.open("ab") as file:
        flock(file.fileno(), wait=True)  # another mirror may be creating it
        if database.exists():
            part.unlink(missing_ok=True)
            return
        file.truncate(0)
        part.with_name(f"{part.name}-journal").unlink(missing_ok=True)
        MlflowClient(f"{_SQLITE}{part}")
        part.rename(database)


def _database(uri: str) -> Path | None:
    if not uri.startswith(_SQLITE):
        return None
    return Path(uri.removeprefix(_SQLITE).split("?")[0]).resolve()
