"""Writes one search and its studies into an MLflow store, through the public client.

What it promises: what stands in the store already is not written again, and a nested run that was left unfinished is
written again. What it does not: two writers of one search at the same time; `mirror` prevents that on one machine.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, Run

from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.storage.canonical import content_hash
from tacevo.tracking.mlflow_store import PARENT_TAG, find_or_create_run, log, tagged_runs, user_tags
from tacevo.tracking.params import Point, note

#: Tags that name a search, a candidate and a study within it, and the digest of a finished search.
RUN_TAG = "tacevo.run"

CANDIDATE_TAG = "tacevo.candidate"

STUDY_TAG = "tacevo.study"

DIGEST_TAG = "tacevo.digest"

#: The tag that MLflow shows as a run's description, in Markdown.
NOTE_TAG = "mlflow.note.content"

#: The hash of the line that a nested run comes from: a candidate's in the ledger, the last one of a study's scores.
LINE_TAG = "tacevo.line"

#: What a study found in short, among its artifacts.
_FOUND = "outcome.md"

#: What the report page is called, in the run directory and among the artifacts.
_PAGE = "report.html"

#: A metric that every generation has; by its steps the generations in a store are known.
_EVERY_GENERATION = "candidates"

#: One that is known only once the search has ended.
_ARCHIVE_MEDIAN = "archive_median"


def search_key(header: str, name: str, sweep: str) -> str:
    """Return what a search is found by: the hash of its ledger's first line, and the names of run and sweep."""
    return content_hash([header, name, sweep])


class SearchWriter:
    """A search's run, found by its `search_key` or created, and what the store holds of the search already.

    Args:
        experiment: its id.
        key: identifies the search; a string without quotes.
        name: what a new run is called.
        tags: of the search's run.
        source: tags of the search and of every candidate that name its code.
    """

    def __init__(
        self,
        client: MlflowClient,
        experiment: str,
        *,
        key: str,
        name: str,
        tags: Mapping[str, str],
        source: Mapping[str, str],
    ) -> None:
        self._client = client
        self._experiment = experiment
        self._source = dict(source)
        search = find_or_create_run(client, experiment, tag=RUN_TAG, key=key, name=name)
        self._search: str = search.info.run_id
        self._params = frozenset(search.data.params)
        self._generations = self._steps(search, _EVERY_GENERATION)
        self._medians = self._steps(search, _ARCHIVE_MEDIAN)
        self._nested = self._finished_runs()
        #: The digest of what stands there, if it is whole, and whether it has a description.
        self._digest = search.data.tags.get(DIGEST_TAG)
        self._is_described = NOTE_TAG in search.data.tags
        for tag, value in {**tags, **self._source}.items():
            if search.data.tags.get(tag) != value:
                client.set_tag(self._search, tag, value)
        client.update_run(self._search, status="RUNNING")
        if DIGEST_TAG in search.data.tags:
            client.delete_tag(self._search, DIGEST_TAG)  # a longer run has another one

    def write_params(self, params: Mapping[str, str]) -> None:
        """Write the search's params; MLflow lets none change, so one that stands already stays as it is."""
        log(self._client, self._search, {key: params[key] for key in params.keys() - self._params}, ())

    def write_data(self, data: Mapping[str, str]) -> None:
        """Write the data set that the search trains on as an input of its run; MLflow keeps an equal one once."""
        context = InputTag(key="mlflow.data.context", value="training")
        self._client.log_inputs(self._search, [DatasetInput(Dataset(**data), [context])])

    def write_generation(self, generation: int, measures: Sequence[Point]) -> None:
        """Write a generation's metrics on the search's run."""
        if generation not in self._generations:
            log(self._client, self._search, {}, measures)
            self._generations.add(generation)

    def write_candidate(
        self, line: CandidateLine, seal: str, params: Mapping[str, str], measures: Sequence[Point], source: Path
    ) -> None:
        """Write a candidate as a nested run, with its source if that exists; raises as `lacks`."""
        if not self.lacks(line.id, seal):
            return
        run = self._begin(CANDIDATE_TAG, line.id, seal, self._source)
        log(self._client, run, params, measures)
        if source.exists():
            self._client.log_artifact(run, str(source))
        self._client.set_terminated(run, "FINISHED" if line.stage is None else "FAILED")

    @property
    def lacks_medians(self) -> bool:
        """Whether a generation stands there without the median of its archive."""
        return not self._medians >= self._generations

    def write_medians(self, medians: Sequence[float | None]) -> None:
        """Write the median fitness of the archive after each generation that has none yet."""
        points = [
            (_ARCHIVE_MEDIAN, median, step)
            for step, median in enumerate(medians)
            if median is not None and step not in self._medians
        ]
        log(self._client, self._search, {}, points)

    def write_study(
        self,
        name: str,
        digest: str,
        params: Mapping[str, str],
        measures: Sequence[Point],
        *,
        command: str,
        description: str,
        files: Mapping[str, str],
        whole: bool,
    ) -> None:
        """Write a finished study that the store lacks as a nested run.

        Args:
            name: of its directory.
            digest: of its scores.
            params: its design and verdicts.
            measures: a point for each metric, network and seed, and the statistics.
            command: that made it.
            description: what it found, in Markdown.
            files: further artifacts by name.
            whole: whether every training came to its end.
        """
        source = {"mlflow.source.name": command, "mlflow.source.type": "LOCAL"}
        run = self._begin(STUDY_TAG, name, digest, {**source, NOTE_TAG: note(description, _FOUND)})
        log(self._client, run, params, measures)
        for file, text in {_FOUND: description, **files}.items():
            self._client.log_text(run, text, file)
        self._client.set_terminated(run, "FINISHED" if whole else "FAILED")

    def lacks(self, name: str, seal: str) -> bool:
        """Return whether the store lacks a candidate or study of a name; the hash of its line tells it apart.

        Raises:
            RunError: the store holds another one of that name.
        """
        if self._nested.get(name, seal) != seal:
            raise RunError(
                f"those of another search of the same settings and name, from {name} on",
                place=f"MLflow run {self._search}",
                expected="the candidates and studies of this run",
                remedy="delete that run in MLflow, or rename the run directory, and run `tacevo track` again",
            )
        return name not in self._nested

    def _begin(self, tag: str, name: str, seal: str, tags: Mapping[str, str]) -> str:
        """Create a nested run, which counts once it is terminated; return its id."""
        tags = {PARENT_TAG: self._search, tag: name, LINE_TAG: seal, **tags, **user_tags()}
        run: str = self._client.create_run(self._experiment, run_name=name, tags=tags).info.run_id
        return run

    def finish(self, digest: str, run_dir: Path) -> None:
        """End the search's run as finished, with its digest, its summary as a description, and what there is to read.

        That is the summary and the report page of the run directory, unless the run has ended since. Of a digest that
        stands there already, only what is missing is written, and a page that has become another one, as after a study.
        """
        is_new = self._digest != digest
        files = () if is_new else self._client.list_artifacts(self._search)
        standing = {file.path: file.file_size for file in files}
        summary = run_dir / "summary.md"
        if summary.exists():
            if is_new or not self._is_described:
                self._client.set_tag(self._search, NOTE_TAG, note(summary.read_text(encoding="utf-8"), summary.name))
            if summary.name not in standing:
                self._client.log_artifact(self._search, str(summary))
            page = run_dir / _PAGE
            is_current = page.exists() and page.stat().st_mtime >= summary.stat().st_mtime
            if is_current and page.stat().st_size != standing.get(_PAGE):
                self._client.log_artifact(self._search, str(page))
        self._client.set_tag(self._search, DIGEST_TAG, digest)
        self._client.set_terminated(self._search, "FINISHED")

    def stop(self) -> None:
        """End the search's run as killed."""
        self._client.set_terminated(self._search, "KILLED")

    def _steps(self, search: Run, metric: str) -> set[int]:
        """Return the steps at which the search's run has a metric."""
        history = self._client.get_metric_history(self._search, metric) if metric in search.data.metrics else ()
        return {point.step for point in history}

    def _finished_runs(self) -> dict[str, str]:
        """Return the hashes of the candidates and studies that the store holds whole; delete the runs of others.

        What else is nested there, such as a model or a user's own run, is left alone.
        """
        known: dict[str, str] = {}
        for run in list(tagged_runs(self._client, self._experiment, PARENT_TAG, self._search)):
            name = run.data.tags.get(CANDIDATE_TAG) or run.data.tags.get(STUDY_TAG)
            if name is None:
                continue
            if run.info.status == "RUNNING":
                self._client.delete_run(run.info.run_id)
            else:
                known[name] = run.data.tags[LINE_TAG]
        return known
