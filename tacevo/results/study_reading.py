"""Finished studies as records; one that is not whole is rejected, with the rows named."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from tacevo.errors import RunError
from tacevo.results.study import RecordedStudy
from tacevo.results.study_checks import check_study
from tacevo.results.study_directory import FinishedStudy, StudyDirectory
from tacevo.results.study_lines import Design, FailedLine, ScoreLine
from tacevo.text import listed

#: Rows that a message names.
MOST = 6


def load_study(path: Path) -> RecordedStudy:
    """Read the directory of a finished study, `RUN/studies/NAME`.

    Raises:
        RunError: it does not hold a study, is not finished or was edited; or as `as_study`.
    """
    return as_study(StudyDirectory(path).read_finished())


def as_study(finished: FinishedStudy) -> RecordedStudy:
    """Return a study whose files were read.

    Raises:
        RunError: it is a noise run, or not one score for each network and seed; the message names the rows.
    """
    path, record, scores = finished.path, finished.record, finished.scores
    _check_failed(path, [row for row in scores.rows if isinstance(row, FailedLine)])
    found, facts = scores.header, scores.header.data
    if found.terms is None:
        raise RunError("a noise run, which has none", place=str(path), expected="a study with test scores")
    for name in ("units", "scale"):
        given: tuple[object, ...] = getattr(record, name)
        if len(given) not in {0, len(facts.names)}:
            expected = f"one for each of {listed(facts.names)}"
            raise RunError(listed(map(str, given)), place=f"{path}/study.json, {name}", expected=expected)
    study = RecordedStudy(
        **{field.name: getattr(found, field.name) for field in fields(Design)},
        units=record.units,
        scale=record.scale,
        scores=tuple(row for row in scores.rows if isinstance(row, ScoreLine)),
    )
    check_study(study)
    return study


def check_alike(studies: Sequence[RecordedStudy]) -> None:
    """Check that studies of one task, each on its run's own data, were trained alike and on the same data.

    Each task is compared with itself. Studies on other data are not compared.

    Raises:
        RunError: recipe, numerics, data fingerprint or number of seeds differ; the message names the rows.
    """
    first: dict[str, RecordedStudy] = {}
    for study in studies:
        if study.other_data:
            continue
        other = first.setdefault(study.task, study)
        for field in ("fingerprint", "recipe", "numerics", "seeds"):
            ours, theirs = getattr(other, field), getattr(study, field)
            if ours != theirs:
                raise RunError(
                    f"{theirs} for {_networks(study)}",
                    place=f"the studies of {study.task}, {field}",
                    expected=f"{ours} as for {_networks(other)}",
                    remedy="study both runs alike",
                )


def _networks(study: RecordedStudy) -> str:
    return f"{listed(network.name for network in study.networks)} of run {study.run[:12]}"


def _check_failed(path: Path, failed: Sequence[FailedLine]) -> None:
    """Check that no training failed."""
    if failed:
        rows = listed((f"{row.network} with seed {row.seed}" for row in failed), most=MOST)
        reasons = listed(sorted({row.reason for row in failed}))
        raise RunError(
            f"{len(failed)} that failed ({reasons}): {rows}",
            place=str(path),
            expected="a training of every network with every seed, without which no statistics are right",
            remedy="study again with more seconds= or memory_mib=, or with fewer elites=",
        )
