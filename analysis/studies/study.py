"""Finished studies as records; what is not whole is refused with the rows named."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from analysis.studies.scores import Network, Score, Study
from analysis.studies.study_checks import check_study
from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Recipe
from tacevo.storage.study_directory import StudyDirectory
from tacevo.studies.terms import Terms

#: Rows that a message names.
MOST = 6


def load_study(path: Path) -> Study:
    """Read the folder of a finished study, `RUN/studies/NAME`.

    Raises:
        RunError: it is no study, is not finished, was edited, or is not one score for each network and seed; the
            message names the rows.
    """
    directory = StudyDirectory(path)
    described = directory.read()
    header, *lines = directory.read_scores()
    if described.get("digest") != (header, *lines)[-1]["hash"]:
        raise RunError(f"{path} is not finished, or its digest was edited; `tacevo study` continues it")
    try:
        _refuse_failed(path, lines)
        study = _study(header, lines, described["units"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{path} is damaged: {type(error).__name__}: {error}") from error
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


def _refuse_failed(path: Path, lines: Sequence[Mapping[str, Json]]) -> None:
    """Refuse trainings that came to no end."""
    failed = [line for line in lines if "reason" in line]
    if failed:
        rows = [f"{line['network']}, seed {line['seed']}" for line in failed]
        named = "; ".join(rows[:MOST]) + (f" and {len(rows) - MOST} more" if len(rows) > MOST else "")
        reasons = ", ".join(sorted({line["reason"] for line in failed}))
        raise RunError(
            f"{path} is incomplete: {named} came to no end ({reasons}); no statistics are right without them. "
            "Study again with more seconds= or memory_mib=, or with fewer elites="
        )


def _study(header: Mapping[str, Json], lines: Sequence[Mapping[str, Json]], units: Sequence[str]) -> Study:
    facts = DataFacts.from_json(header["data"])
    if len(units) not in {0, len(facts.names)}:
        raise ValueError(f"study.json needs a unit for each of {list(facts.names)}, or none; got {units}")
    return Study(
        run=header["run"],
        task=header["task"],
        kind=facts.kind,
        names=facts.names,
        units=tuple(units),
        fingerprint=facts.fingerprint,
        recipe=Recipe.from_json(header["recipe"]),
        numerics=header["numerics"],
        terms=Terms.from_json(header["terms"]),
        seeds=header["seeds"],
        networks=tuple(Network(**network) for network in header["networks"]),
        scores=tuple(_score(line) for line in lines),
    )


def _score(line: Mapping[str, Json]) -> Score:
    counts = line["confusion"]
    return Score(
        network=line["network"],
        seed=line["seed"],
        epoch=line["epoch"],
        metrics=line["metrics"],
        confusion=None if counts is None else tuple(tuple(row) for row in counts),
    )
