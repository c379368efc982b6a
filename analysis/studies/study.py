"""Finished studies as records; what is not whole is refused with the rows named."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from analysis.studies.scores import Network, Score, Study
from analysis.studies.study_checks import check_study
from tacevo.errors import RunError
from tacevo.studies.directory import StudyDirectory
from tacevo.studies.lines import FailedLine, Row, ScoreLine, StudyHeader

#: Rows that a message names.
MOST = 6


def load_study(path: Path) -> Study:
    """Read the folder of a finished study, `RUN/studies/NAME`.

    Raises:
        RunError: it is no study, is not finished, was edited, or is not one score for each network and seed; the
            message names the rows.
    """
    directory = StudyDirectory(path)
    record, scores = directory.read(), directory.read_scores()
    if record.digest != scores.digest:
        raise RunError(f"{path} is not finished, or its digest was edited; `tacevo study` continues it")
    study = _study(path, scores.header, _scores(path, scores.rows), record.units)
    check_study(study)
    return study


def refuse_mixed(studies: Sequence[Study]) -> None:
    """Refuse to put studies of one task together that were trained otherwise or on other data.

    Args:
        studies: of one task or of several; each task is compared with itself.

    Raises:
        RunError: recipe, numerics, data fingerprint or number of seeds differ; the message names the rows.
    """
    first: dict[str, Study] = {}
    for study in studies:
        other = first.setdefault(study.task, study)
        for field in ("fingerprint", "recipe", "numerics", "seeds"):
            ours, theirs = getattr(other, field), getattr(study, field)
            if ours != theirs:
                raise RunError(
                    f"the studies of {study.task} differ in {field}: {ours} for {_networks(other)} of run "
                    f"{other.run[:12]}, {theirs} for {_networks(study)} of run {study.run[:12]}; study both runs alike"
                )


def _networks(study: Study) -> str:
    return ", ".join(network.name for network in study.networks)


def _scores(path: Path, rows: Sequence[Row]) -> tuple[Score, ...]:
    """Return the scores; refuse trainings that failed."""
    failed = [row for row in rows if isinstance(row, FailedLine)]
    if failed:
        names = [f"{row.network}, seed {row.seed}" for row in failed]
        named = "; ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "")
        reasons = ", ".join(sorted({row.reason for row in failed}))
        raise RunError(
            f"{path} is incomplete: {named} came to no end ({reasons}); no statistics are right without them. "
            "Study again with more seconds= or memory_mib=, or with fewer elites="
        )
    return tuple(
        Score(network=row.network, seed=row.seed, epoch=row.epoch, metrics=row.metrics, confusion=row.confusion)
        for row in rows
        if isinstance(row, ScoreLine)
    )


def _study(path: Path, header: StudyHeader, scores: tuple[Score, ...], units: Sequence[str]) -> Study:
    if len(units) not in {0, len(header.data.names)}:
        expected = f"a unit for each of {list(header.data.names)}, or none"
        raise RunError(str(list(units)), place=f"{path}/study.json, units", expected=expected)
    return Study(
        run=header.run,
        task=header.task,
        kind=header.data.kind,
        names=header.data.names,
        units=tuple(units),
        fingerprint=header.data.fingerprint,
        recipe=header.recipe,
        numerics=header.numerics,
        terms=header.terms,
        seeds=header.seeds,
        networks=tuple(Network(**asdict(network)) for network in header.networks),
        scores=scores,
    )
