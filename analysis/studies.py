"""Finished studies as records; what is not whole is refused with the rows named."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from analysis.results import Network, Score, Study
from tacevo.errors import RunError
from tacevo.records import DataFacts, Json, Recipe
from tacevo.studydir import StudyDirectory

#: A network and a seed.
_Row = tuple[str, int]


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
        _refuse_incomplete(path, header, lines)
        study = _study(header, lines)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{path} is damaged: {type(error).__name__}: {error}") from error
    _refuse_unlike(path, study)
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


def _refuse_incomplete(path: Path, header: Mapping[str, Json], lines: Sequence[Mapping[str, Json]]) -> None:
    """Refuse scores that are not one for each network and seed, or trainings that came to no end."""
    expected = [(network["name"], seed) for network in header["networks"] for seed in range(header["seeds"])]
    found = [(line["network"], line["seed"]) for line in lines]
    missing = [row for row in expected if row not in found]
    if missing:
        raise RunError(f"{path} has no score of {_rows(missing)}; delete the folder, and `tacevo study` writes it anew")
    if found != expected:
        surplus = [row for place, row in enumerate(found) if row not in expected or row in found[:place]]
        raise RunError(f"{path} has scores out of order or too often: {_rows(surplus or found)}; delete the folder")
    failed = [(line["network"], line["seed"]) for line in lines if "reason" in line]
    if failed:
        reasons = ", ".join(sorted({line["reason"] for line in lines if "reason" in line}))
        raise RunError(
            f"{path} is incomplete: {_rows(failed)} came to no end ({reasons}); no statistics are right without them. "
            "Study again with more seconds= or memory_mib=, or with fewer elites="
        )


def _refuse_unlike(path: Path, study: Study) -> None:
    """Refuse networks that were measured by other metrics than the first one."""
    names = set(study.scores[0].metrics)
    odd = [(score.network, score.seed) for score in study.scores if set(score.metrics) != names]
    if odd:
        raise RunError(f"{path} has other metrics for {_rows(odd)} than for the rest; delete the folder")


def _rows(rows: Sequence[_Row], most: int = 6) -> str:
    """Name rows, e.g. `variant 1, seed 3; variant 2, seed 0`."""
    named = [f"{network}, seed {seed}" for network, seed in rows]
    return "; ".join(named[:most]) + (f" and {len(named) - most} more" if len(named) > most else "")


def _study(header: Mapping[str, Json], lines: Sequence[Mapping[str, Json]]) -> Study:
    facts = DataFacts.from_json(header["data"])
    return Study(
        run=header["run"],
        task=header["task"],
        kind=facts.kind,
        names=facts.names,
        fingerprint=facts.fingerprint,
        recipe=Recipe.from_json(header["recipe"]),
        numerics=header["numerics"],
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
        validation_loss=line["validation_loss"],
        metrics=line["metrics"],
        confusion=None if counts is None else tuple(tuple(row) for row in counts),
    )
