"""Writes one search into an MLflow store, through the public client.

What it promises: what stands in the store already is not written again, and a candidate's run that was left
unfinished, or stands there twice, goes. What it does not: two writers of one search at the same time; `mirror` sees
to that.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from mlflow import MlflowClient

from tacevo.tracking.entries import Measure
from tacevo.tracking.runs import PARENT_TAG, all_runs, claim, label, log, nested, tagged

#: Tags that name a search, a candidate within it, and the digest of a finished search.
RUN_TAG = "tacevo.run"
CANDIDATE_TAG = "tacevo.candidate"
DIGEST_TAG = "tacevo.digest"


class SearchWriter:
    """A search's run, found by its tag or created, and what the store holds of the search already.

    Args:
        client: the store.
        experiment: the experiment's id.
        key: names the search; a string without quotes.
        name: what a new run is called.
        tags: what else the run is tagged with.
    """

    def __init__(
        self, client: MlflowClient, experiment: str, *, key: str, name: str, tags: Mapping[str, str] | None = None
    ) -> None:
        self._client = client
        self._experiment = experiment
        search = claim(client, experiment, tag=RUN_TAG, key=key, name=name)
        self._search: str = search.info.run_id
        self._params = frozenset(search.data.params)
        self._steps = {metric: self._steps_of(metric) for metric in search.data.metrics}
        self._candidates = frozenset(self._finished_candidates())
        label(client, search, tags or {})
        client.update_run(self._search, status="RUNNING")
        if DIGEST_TAG in search.data.tags:
            client.delete_tag(self._search, DIGEST_TAG)  # it was the digest of a shorter run, perhaps

    def write_params(self, params: Mapping[str, str]) -> None:
        """Write the search's params; MLflow lets none change, so one that stands already stays as it is."""
        log(self._client, self._search, {key: params[key] for key in params.keys() - self._params}, ())

    def write_generation(self, measures: Sequence[Measure]) -> None:
        """Write a generation's metrics on the search's run."""
        new = [measure for measure in measures if measure.step not in self._steps.get(measure.key, ())]
        log(self._client, self._search, {}, new)

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
        tags = {PARENT_TAG: self._search, CANDIDATE_TAG: name}
        run: str = self._client.create_run(self._experiment, run_name=name, tags=tags).info.run_id
        log(self._client, run, params, measures)
        if source.exists():
            self._client.log_artifact(run, str(source))
        self._client.set_terminated(run, "FAILED" if failed else "FINISHED")

    def end(self, digest: str | None) -> None:
        """End the search's run: finished with a digest, or killed without one."""
        unfinished = f"{tagged(PARENT_TAG, self._search)} and attributes.status = 'RUNNING'"
        for run in all_runs(self._client, self._experiment, unfinished):
            self._client.delete_run(run.info.run_id)  # made by a request that was sent twice (`claim`)
        if digest is not None:
            self._client.set_tag(self._search, DIGEST_TAG, digest)
        self._client.set_terminated(self._search, "KILLED" if digest is None else "FINISHED")

    def _steps_of(self, metric: str) -> frozenset[int]:
        return frozenset(point.step for point in self._client.get_metric_history(self._search, metric))

    def _finished_candidates(self) -> Iterator[str]:
        """Give the candidates that stand whole in the store, and delete the runs of others, and second ones."""
        known: set[str] = set()
        for run in nested(self._client, self._experiment, self._search):
            name = run.data.tags[CANDIDATE_TAG]
            if run.info.status in {"FINISHED", "FAILED"} and name not in known:
                known.add(name)
                yield name
            else:
                self._client.delete_run(run.info.run_id)
