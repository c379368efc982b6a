"""What the analysis says of a finished run, for MLflow: the archive's median by generation, studies and noise runs."""

import contextlib
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from analysis.report.collection import Compared, outcomes, read_studies
from analysis.report.outputs import outputs
from analysis.runs.archive_history import archive_medians
from analysis.runs.niches import load_niches
from analysis.studies.comparison import of_whole
from analysis.studies.reestimates import Reestimates
from analysis.table import Table
from analysis.tables.comparison import scores_table, verdicts_table
from analysis.tables.rendering import as_csv, as_markdown
from tacevo.errors import RunError, StoreError
from tacevo.records import Json, to_json, written
from tacevo.results.run import RecordedRun, read_run
from tacevo.results.study_directory import FinishedStudy, studies_of
from tacevo.results.study_lines import FailedLine, ScoreLine, StudyRecord
from tacevo.storage.run_directory import RunDirectory
from tacevo.tracking.shown import EVERY_GENERATION, STUDY_TAG, Point, Shown, config_params, note
from tacevo.tracking.store import NOTE_TAG, Search

#: What MLflow does not take in the name of a metric: that of an output may be any text.
_FOREIGN = re.compile(r"[^\w.\- ]")

#: A metric that is known only once the search has ended.
_ARCHIVE_MEDIAN = "archive_median"

#: What a study found in short, among its artifacts.
_FOUND = "outcome.md"

#: The columns of a comparison that stand in the store by network.
_STATISTICS = ("median", "p_holm", "a12", "difference")


def write_findings(search: Search, directory: RunDirectory) -> None:
    """Write what the store lacks of a finished run: the median fitness of its archive by generation, and its studies.

    There are no medians where the niches that the run was searched with are not at hand, as its stores have them.

    Raises:
        RunError: the run or a study is damaged, or the store holds another study of that name.
    """
    if not search.steps(_ARCHIVE_MEDIAN) >= search.steps(EVERY_GENERATION):
        with contextlib.suppress(RunError, StoreError):
            run = read_run(directory.path)
            medians = archive_medians(run, load_niches(run).networks)
            points = [(_ARCHIVE_MEDIAN, median, step) for step, median in enumerate(medians) if median is not None]
            search.add_points(points, known_by=_ARCHIVE_MEDIAN)
    known = {one.path.name: one.read().digest for one in studies_of(directory.path)}
    missing = {name for name, digest in known.items() if digest is not None and search.lacks(name, digest)}
    if not missing:
        return
    run = read_run(directory.path)
    studies = read_studies(run)
    told, compared = outcomes(run, studies), {one.name: one for one in studies.studies}
    again = {one.name: one for one in studies.reestimates}
    for finished in studies.finished:
        name = finished.path.name
        if name not in missing:
            continue
        found = as_markdown(told[name]) if name in told else ""
        search.add(_shown(run, finished, found, compared.get(name), again.get(name)))


def _shown(
    run: RecordedRun, finished: FinishedStudy, found: str, compared: Compared | None, again: Reestimates | None
) -> Shown:
    """Show a study or a noise run; `found` is what it found in short, in Markdown."""
    is_noise, table = finished.record.is_noise, _table(run, compared, again)
    tables = {} if table is None else {f"{table.name}.md": as_markdown(table), f"{table.name}.csv": as_csv(table)}
    command = "tacevo noise" if is_noise else "tacevo study"
    return Shown(
        tag=STUDY_TAG,
        name=finished.path.name,
        line=finished.digest,
        params=study_params(finished.record) | _verdicts(compared),
        points=[*score_measures(finished), *_statistics(compared, again if is_noise else None)],
        tags={"mlflow.source.name": command, "mlflow.source.type": "LOCAL", NOTE_TAG: note(found, _FOUND)},
        files={_FOUND: found, **tables},
        failed=any(isinstance(row, FailedLine) for row in finished.rows),
    )


def study_params(study: StudyRecord) -> dict[str, str]:
    """Return what a study was to find out: its run, its design, its plan if it follows one, the id of each network."""
    other = {"other_data": dict(study.other_data), "other_device": dict(study.other_device)}
    recorded = to_json(study) | {"recipe": written(study.recipe), **other}
    names = "seed", "seeds", "recipe", "numerics", "device", "terms", "chosen_by", "validated", *other, "plan", "rules"
    networks: dict[str, Json] = {network.name: network.id for network in study.networks}
    design = {name: recorded[name] for name in names if recorded.get(name) or name == "seed"}
    return config_params({"digest": study.run, **design, "network": networks})


def score_measures(study: FinishedStudy) -> Iterator[Point]:
    """Yield each metric of each training, as `mse/variant 1`; the step is the seed's number."""
    for row in study.rows:
        if isinstance(row, ScoreLine):
            is_noise = study.record.is_noise
            of_training = {"fitness" if is_noise else "validation_loss": row.validation_loss, "epoch": row.epoch}
            yield from _named({**of_training, **row.metrics}, row.network, row.seed)


def _statistics(compared: Compared | None, again: Reestimates | None) -> Iterator[Point]:
    """Yield what the seeds of each network say together, as `median/variant 1`."""
    if compared is not None and compared.comparisons is not None:
        baseline = compared.study.values(compared.study.networks[0].name, compared.study.primary)
        yield from _named({"median": float(np.median(baseline))}, compared.study.networks[0].name, 0)
        for row in of_whole(compared.comparisons).to_dict("records"):
            yield from _named({name: row[name] for name in _STATISTICS}, row["network"], 0)
    if again is not None:
        for network, median in zip(again.networks, again.medians, strict=True):
            yield from _named({"median": median}, network.name, 0)


def _named(figures: Mapping[str, Any], network: str, step: int) -> Iterator[Point]:
    for name, value in figures.items():
        if math.isfinite(value):
            yield f"{_FOREIGN.sub('_', name)}/{network}", float(value), step


def _verdicts(compared: Compared | None) -> dict[str, str]:
    rows = of_whole(None if compared is None else compared.comparisons)
    return {f"verdict.{row['network']}": row["verdict"] for row in rows.to_dict("records")}


def _table(run: RecordedRun, compared: Compared | None, again: Reestimates | None) -> Table | None:
    """Return the table of a study's verdicts, or of its scores where none can be given; of a noise run its own."""
    if compared is not None:
        comparisons = compared.comparisons
        return scores_table(compared.study) if comparisons is None else verdicts_table(compared.study, comparisons)
    if again is None or "noise" in outputs(ours=True).missing:
        return None
    from analysis.tables.noise import noise_table  # of an output, which may be missing

    return noise_table(again, run.task, run.record.trivial)
