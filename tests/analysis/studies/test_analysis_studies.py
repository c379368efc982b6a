"""Promise: a study is read whole or refused, with the rows named."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ledger_lines import score, study_header
from refusals import refused
from studies import study_of

from tacevo.choices import MarginKind, Numerics
from tacevo.config.study import Margin
from tacevo.errors import RunError
from tacevo.records import DataFacts, Kind, Limits, Reason, Recipe, Stage
from tacevo.results.study import RecordedStudy, check_alike, load_study
from tacevo.results.study_directory import StudyDirectory
from tacevo.results.study_lines import FailedLine, Row, ScoreLine, StudyTerms

FACTS = DataFacts(
    fingerprint="f" * 64,
    kind=Kind.regression,
    counts=(8, 1, 1),
    in_channels=3,
    image_size=32,
    outputs=1,
    names=("depth",),
)
RECIPE = Recipe(epochs=2, batch_size=4, learning_rate=0.1, optimiser="adam", limits=Limits(seconds=1.0, memory_mib=100))
TERMS = StudyTerms(alpha=0.05, margin=Margin(value=0.1, kind=MarginKind.relative))
HEADER = study_header(run="r" * 64, data=FACTS, recipe=RECIPE, seeds=3, terms=TERMS)
SCORES: list[Row] = [
    score(network.name, seed, place + seed / 10) for place, network in enumerate(HEADER.networks) for seed in range(3)
]


def written(path: Path, scores: Sequence[Row] = SCORES, **changes: Any) -> Path:
    """Write a finished study with sound hashes."""
    directory, header = StudyDirectory(path), replace(HEADER, **changes)
    directory.begin(header, scale=(1.0,), units=("mm",), versions={}, machine={})
    directory.finish(header, scores)
    return path


def test_study_comes_back_as_it_was(tmp_path: Path) -> None:
    """Networks, recipe and the values of each in the order of the seeds."""
    study = load_study(written(tmp_path / "study"))
    assert (study.task, study.kind, study.names, study.seeds) == ("force", Kind.regression, ("depth",), 3)
    assert (study.terms, study.units) == (TERMS, ("mm",))
    assert (study.recipe, study.fingerprint, study.numerics) == (RECIPE, "f" * 64, "portable")
    assert [network.name for network in study.networks] == ["baseline", "variant 1"]
    assert np.array_equal(study.values("variant 1", "mse"), [1.0, 1.1, 1.2])


def test_scores_that_contradict_each_other_are_not_read(tmp_path: Path) -> None:
    """A regression has no confusion, and the root of an error is that of the error, whatever the hashes say."""
    rows = [row for row in SCORES if isinstance(row, ScoreLine)]
    for place, scores in (
        ("confusion", [replace(row, confusion=((2, 1), (0, 3))) for row in rows]),
        ("metrics.rmse", [replace(row, metrics={**row.metrics, "rmse": 0.9}) for row in rows]),
        ("metrics.mse", [replace(row, metrics={**row.metrics, "mse": -0.1}) for row in rows]),
    ):
        with refused(RunError, place=place):
            load_study(written(tmp_path / place, scores))


def failed(scores: list[Row]) -> list[Row]:
    """Let two trainings fail."""
    reason: dict[str, Any] = {"id": "g00s00", "evaluation": "e", "stage": Stage.train, "reason": Reason.out_of_time}
    return [
        FailedLine(network=row.network, seed=row.seed, **reason) if place in (1, 5) else row
        for place, row in enumerate(scores)
    ]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda scores: scores[:4], "missing: variant 1 with seed 1, variant 1 with seed 2"),
        (lambda scores: [*scores[:1], *scores[2:]], "missing: baseline with seed 1"),
        (
            lambda scores: [*scores, replace(scores[0], seed=3)],
            "not of the study: baseline with seed 3",
        ),
        (lambda scores: [*scores, scores[2]], "twice: baseline with seed 2"),
        (failed, "2 that failed (out_of_time): baseline with seed 1, variant 1 with seed 2"),
        (
            lambda scores: [*scores[:5], replace(scores[5], metrics={"mae": 1.0})],
            "without some metric: baseline with seed 0",
        ),
    ],
)
def test_what_is_not_whole_is_refused_with_its_rows(
    change: Callable[[list[Row]], list[Row]], named: str, tmp_path: Path
) -> None:
    """Unequal seeds, rows twice, trainings without an end, unlike metrics: sealed, and still no study."""
    with refused(RunError, got=named):
        load_study(written(tmp_path / "study", change(SCORES)))


def test_unfinished_study_is_refused(tmp_path: Path) -> None:
    """Before its scores are there, and where they were cut off after the digest was written."""
    directory = StudyDirectory(tmp_path / "begun")
    directory.begin(HEADER, scale=(), units=(), versions={}, machine={})
    with refused(RunError, place="begun", got="one that was interrupted"):
        load_study(directory.path)
    path = written(tmp_path / "cut")
    scores = path / "scores.jsonl"
    scores.write_text("\n".join(scores.read_text().splitlines()[:-1]) + "\n")
    with refused(RunError, place="cut/study.json", expected="with which scores.jsonl ends"):
        load_study(path)


def test_units_that_do_not_fit_the_outputs_are_refused(tmp_path: Path) -> None:
    """Nothing else says which output is in newtons."""
    path = written(tmp_path / "study") / "study.json"
    path.write_text(path.read_text().replace('"mm"', '"mm", "N"'))
    with refused(RunError, place="study.json, units", expected="one for each of depth", got="mm, N"):
        load_study(path.parent)


def test_value_that_is_not_a_number_is_refused(tmp_path: Path) -> None:
    """NaN can be in no sealed line, so whoever writes it in is found, by the row."""
    path = written(tmp_path / "study")
    scores = path / "scores.jsonl"
    scores.write_text(scores.read_text().replace('"mse":1.1', '"mse":NaN'))
    with refused(RunError, place="variant 1, seed 1 (g00s00), metrics.mse", expected="finite number"):
        load_study(path)


@pytest.mark.parametrize(
    ("change", "field", "values"),
    [
        (
            lambda study: replace(study, data=replace(study.data, fingerprint="e" * 64)),
            "fingerprint",
            ("f" * 64, "e" * 64),
        ),
        (lambda study: replace(study, recipe=replace(RECIPE, epochs=9)), "recipe", ("epochs=2", "epochs=9")),
        (lambda study: replace(study, numerics=Numerics.fast), "numerics", ("portable", "fast")),
        (lambda study: replace(study, seeds=2), "seeds", ("3", "2")),
    ],
)
def test_mixed_studies_are_refused(
    change: Callable[[RecordedStudy], RecordedStudy], field: str, values: tuple[str, str], tmp_path: Path
) -> None:
    """Two studies of one task must have been made alike; those of two tasks need not."""
    study = load_study(written(tmp_path / "study"))
    check_alike([study, study])
    check_alike([study, replace(change(study), task="grating")])
    check_alike([study, replace(change(study), other_data=(("a", 1),))])
    with refused(RunError, place=f"the studies of force, {field}", expected=values[0], got=values[1]):
        check_alike([study, change(study)])


@pytest.mark.parametrize(
    ("values", "seed"),
    [((0.7, 0.9, 0.8), 2), ((0.9, 0.6, 0.8, 0.7), 3), ((0.5, 0.8, 0.8, 0.9), 1), ((0.9,), 0)],
    ids=["middle", "lower of two", "first of equal ones", "single"],
)
def test_median_seed_stands_for_a_network(values: tuple[float, ...], seed: int) -> None:
    """It has the median, and which one it is follows from the scores alone."""
    assert study_of({"baseline": values}, kind=Kind.classification).median_seed("baseline") == seed


def test_median_seed_is_a_seed() -> None:
    """Not its place among the seeds that there are."""
    study = study_of({"baseline": (0.7, 0.9, 0.8)}, kind=Kind.classification)
    later = replace(study, scores=tuple(replace(score, seed=score.seed + 5) for score in study.scores))
    assert later.median_seed("baseline") == 7
