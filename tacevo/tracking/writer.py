"""Writes one search into an MLflow store, through the public client.

What it promises: what stands in the store already is not written again, and a candidate's run that was left unfinished
is written again. What it does not: two writers of one search at the same time; `mirror` prevents that on one machine.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag

from tacevo.errors import RunError
from tacevo.evolution.lines import CandidateLine
from tacevo.tracking.client import PARENT_TAG, find_or_create_run, log, tagged_runs, user_tags
from tacevo.tracking.entries import Point, note

#: Tags that name a search, a candidate within it, and the digest of a finished search.
RUN_TAG = "tacevo.run"

CANDIDATE_TAG = "tacevo.candidate"

DIGEST_TAG = "tacevo.digest"

#: The tag that MLflow shows as a run's description, in Markdown.
_NOTE_TAG = "mlflow.note.content"

#: The hash of the ledger line that a candidate comes from.
LINE_TAG = "tacevo.line"

#: What the report page is called, in the run directory and among the artifacts.
_PAGE = "report.html"

#: A metric that every generation has; by its steps the generations in a store are known.
_EVERY_GENERATION = "candidates"


class SearchWriter:
    """A search's run, found by its tag or created, and what the store holds of the search already.

    Args:
        experiment: the experiment's id.
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
        known = _EVERY_GENERATION in search.data.metrics
        history = client.get_metric_history(self._search, _EVERY_GENERATION) if known else ()
        self._generations = {point.step for point in history}
        self._candidates = self._finished_candidates()
        #: The digest of what stands there, if it is whole, and whether it has a description.
        self._digest = search.data.tags.get(DIGEST_TAG)
        self._is_described = _NOTE_TAG in search.data.tags
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

    def write_candidate(
        self, line: CandidateLine, seal: str, params: Mapping[str, str], measures: Sequence[Point], source: Path
    ) -> None:
        """Write a candidate as a nested run; the hash of its line tells it apart, and its source is kept if it exists.

        Raises:
            RunError: the store holds this candidate of another ledger.
        """
        if line.id in self._candidates:
            if self._candidates[line.id] != seal:
                raise RunError(
                    f"those of another search of the same settings and name, from candidate {line.id} on",
                    place=f"MLflow run {self._search}",
                    expected="the candidates of this ledger",
                    remedy="delete that run in MLflow, or rename the run directory, and run `tacevo track` again",
                )
            return
        tags = {PARENT_TAG: self._search, CANDIDATE_TAG: line.id, LINE_TAG: seal, **self._source, **user_tags()}
        run: str = self._client.create_run(self._experiment, run_name=line.id, tags=tags).info.run_id
        log(self._client, run, params, measures)
        if source.exists():
            self._client.log_artifact(run, str(source))
        self._client.set_terminated(run, "FINISHED" if line.stage is None else "FAILED")

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
                self._client.set_tag(self._search, _NOTE_TAG, note(summary.read_text(encoding="utf-8")))
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

    def _finished_candidates(self) -> dict[str, str]:
        """Return the line hashes of the candidates that the store holds whole; delete the runs of others."""
        known: dict[str, str] = {}
        for run in list(tagged_runs(self._client, self._experiment, PARENT_TAG, self._search)):
            if run.info.status == "RUNNING":
                self._client.delete_run(run.info.run_id)
            else:
                known[run.data.tags[CANDIDATE_TAG]] = run.data.tags[LINE_TAG]
        return known
