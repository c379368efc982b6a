"""Writes one search into an MLflow store, through the public client.

What it promises: what stands in the store already is not written again; what stands there of another ledger goes; and
a candidate's run that was left unfinished, or stands there twice, goes. What it does not: two writers of one search at
the same time; `mirror` sees to that.
"""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import asdict, dataclass
from pathlib import Path

from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, InputTag, Run

from tacevo.tracking.client import PARENT_TAG, all_runs, claim, log, nested, tagged, unlabel
from tacevo.tracking.datasets import DataSet
from tacevo.tracking.entries import Measure

#: Tags that name a search, a candidate within it, and the digest of a finished search.
RUN_TAG = "tacevo.run"

CANDIDATE_TAG = "tacevo.candidate"

DIGEST_TAG = "tacevo.digest"

#: The hash of the ledger line that a candidate comes from, and a search's latest metrics.
LINE_TAG = "tacevo.line"


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """What a ledger says of a candidate itself."""

    #: The candidate's id.
    name: str
    #: The hash of its ledger line.
    line: str
    #: Whether it was turned away.
    failed: bool


class SearchWriter:
    """A search's run, found by its tag or created, and what the store holds of the search already.

    Args:
        client: the store.
        experiment: the experiment's id.
        key: names the search; a string without quotes.
        name: what a new run is called.
        source: tags of the search and of every candidate that name its code.
        ledger: the hashes of the ledger's lines so far. Where the store holds something of another ledger, that run
            is deleted and the search gets a new one, because MLflow lets no metric be taken back.
    """

    def __init__(
        self,
        client: MlflowClient,
        experiment: str,
        *,
        key: str,
        name: str,
        source: Mapping[str, str],
        ledger: Set[str],
    ) -> None:
        self._client = client
        self._experiment = experiment
        self._source = dict(source)
        search = claim(client, experiment, tag=RUN_TAG, key=key, name=name)
        candidates = nested(client, experiment, search.info.run_id)
        if not _lines(search, candidates) <= ledger:
            for run in (*candidates, search):  # the search last: killed among them, this is begun again
                client.delete_run(run.info.run_id)
            search, candidates = claim(client, experiment, tag=RUN_TAG, key=key, name=name), []
        self._search: str = search.info.run_id
        self._tags = dict(search.data.tags)
        self._params = frozenset(search.data.params)
        self._steps = {metric: self._steps_of(metric) for metric in search.data.metrics}
        self._candidates = frozenset(self._finished(candidates))
        self.tag(self._source)
        client.update_run(self._search, status="RUNNING")
        if DIGEST_TAG in self._tags:
            unlabel(client, self._search, DIGEST_TAG)  # it was the digest of a shorter run, perhaps

    def tag(self, tags: Mapping[str, str]) -> None:
        """Tag the search's run; a tag that it has already costs no request."""
        for tag, value in tags.items():
            if self._tags.get(tag) != value:
                self._client.set_tag(self._search, tag, value)
                self._tags[tag] = value

    def write_params(self, params: Mapping[str, str]) -> None:
        """Write the search's params; MLflow lets none change, so one that stands already stays as it is."""
        log(self._client, self._search, {key: params[key] for key in params.keys() - self._params}, ())

    def write_data(self, data: DataSet) -> None:
        """Write the data set that the search trains on as an input of its run; MLflow keeps an equal one once."""
        context = InputTag(key="mlflow.data.context", value="training")
        self._client.log_inputs(self._search, [DatasetInput(Dataset(**asdict(data)), [context])])

    def write_generation(self, line: str, measures: Sequence[Measure]) -> None:
        """Write a generation's metrics on the search's run.

        Args:
            line: the hash of its ledger line.
            measures: its metrics.
        """
        new = [measure for measure in measures if measure.step not in self._steps.get(measure.key, ())]
        if new:
            self.tag({LINE_TAG: line})  # first: no metric stands there that this does not vouch for
            log(self._client, self._search, {}, new)

    def write_candidate(
        self, entry: Entry, params: Mapping[str, str], measures: Sequence[Measure], source: Path
    ) -> None:
        """Write a candidate as a nested run.

        Args:
            entry: the candidate.
            params: params by name.
            measures: its metrics.
            source: the file to keep as its artifact, where it exists.
        """
        if entry.name in self._candidates:
            return
        tags = {PARENT_TAG: self._search, CANDIDATE_TAG: entry.name, LINE_TAG: entry.line, **self._source}
        run: str = self._client.create_run(self._experiment, run_name=entry.name, tags=tags).info.run_id
        log(self._client, run, params, measures)
        if source.exists():
            self._client.log_artifact(run, str(source))
        self._client.set_terminated(run, "FAILED" if entry.failed else "FINISHED")

    def finish(self, digest: str) -> None:
        """End the search's run as finished, with its digest."""
        self._client.set_tag(self._search, DIGEST_TAG, digest)
        self._end("FINISHED")

    def stop(self) -> None:
        """End the search's run as killed."""
        self._end("KILLED")

    def _end(self, status: str) -> None:
        unfinished = f"{tagged(PARENT_TAG, self._search)} and attributes.status = 'RUNNING'"
        for run in all_runs(self._client, self._experiment, unfinished):
            self._client.delete_run(run.info.run_id)  # made by a request that was sent twice (`claim`)
        self._client.set_terminated(self._search, status)

    def _steps_of(self, metric: str) -> frozenset[int]:
        return frozenset(point.step for point in self._client.get_metric_history(self._search, metric))

    def _finished(self, candidates: Sequence[Run]) -> Iterator[str]:
        """Give the candidates that stand whole in the store, and delete the runs of others, and second ones."""
        known: set[str] = set()
        for run in candidates:
            name = run.data.tags[CANDIDATE_TAG]
            if run.info.status in {"FINISHED", "FAILED"} and name not in known:
                known.add(name)
                yield name
            else:
                self._client.delete_run(run.info.run_id)


def _lines(search: Run, candidates: Sequence[Run]) -> set[str]:
    """Give the hashes of the ledger lines that stand in the store; what names none is nobody's."""
    found = {run.data.tags.get(LINE_TAG, "") for run in candidates}
    return found | ({search.data.tags.get(LINE_TAG, "")} if search.data.metrics else set())
