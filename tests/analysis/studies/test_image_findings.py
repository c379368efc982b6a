"""Promise: what a study says of its test images follows from the predictions that it keeps, and from nothing else."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from kept import forces, gratings, keep, study_with
from refusals import refused
from sklearn.metrics import accuracy_score, mean_squared_error
from studies import study_of

from analysis.statistics.images import mcnemar, signed_rank
from analysis.studies.images import ImageFindings, image_findings
from analysis.studies.predictions import Predictions, load_predictions
from analysis.table import Between, Cell, Percent
from analysis.tables.images import image_tables
from tacevo.errors import CacheMissError, RunError
from tacevo.records import Kind
from tacevo.results.study import RecordedStudy
from tacevo.rules import FIRST_STUDY

FORCES, FORCE_PREDICTIONS = forces()
GRATINGS, GRATING_PREDICTIONS = gratings()
OF_FORCES = image_findings(FORCES, FORCE_PREDICTIONS)
OF_GRATINGS = image_findings(GRATINGS, GRATING_PREDICTIONS)


@pytest.mark.parametrize("made", [forces, gratings])
def test_kept_predictions_come_back(made: type, tmp_path: Path) -> None:
    """All of them, in the order of networks and seeds, whatever the order of the lines."""
    study, predictions = made()
    keep(predictions, tmp_path)
    found = load_predictions(replace(study, scores=study.scores[::-1]), tmp_path)
    assert found is not None
    assert list(found.of) == [network.name for network in study.networks]
    assert all(np.array_equal(found.of[name], each) for name, each in predictions.of.items())
    assert np.array_equal(found.labels, predictions.labels)


def test_study_that_keeps_none_says_so() -> None:
    """It is not an error, and its only table names the rules."""
    old = study_of({"baseline": [0.5, 0.6]})
    assert load_predictions(old, Path("nowhere")) is None
    (table,) = image_tables(old, None)
    assert table.rows == (("baseline", "not kept"),)
    assert f"rules {FIRST_STUDY}" in table.notes[0]


def test_score_that_the_predictions_do_not_give_is_found(tmp_path: Path) -> None:
    """Of one seed of one network: the message names both."""
    keep(FORCE_PREDICTIONS, tmp_path)
    first, *others = FORCES.scores
    better = replace(first, metrics={**first.metrics, "mse": 0.0})
    with refused(RunError, place="baseline, seed 0, mse", got="0.0", expected="by its test predictions"):
        load_predictions(replace(FORCES, scores=(better, *others)), tmp_path)


def test_predictions_that_are_missing_are_told(tmp_path: Path) -> None:
    """In the store; or of some trainings, whose scores do not name any."""
    with pytest.raises(CacheMissError):
        load_predictions(FORCES, tmp_path)
    keep(FORCE_PREDICTIONS, tmp_path)
    first, *others = FORCES.scores
    with refused(RunError, expected="the same test labels in every training", got="none"):
        load_predictions(replace(FORCES, scores=(replace(first, kept=None), *others)), tmp_path)
    (table,) = image_tables(FORCES, None)
    assert table.rows[0] == ("baseline", "not found")


def test_ensemble_is_the_mean_of_the_seeds() -> None:
    """Of outputs; of the probabilities of classes, not of logits, whose sizes say nothing."""
    for one in OF_FORCES.ensembles:
        mean = FORCE_PREDICTIONS.of[one.network].mean(axis=0)
        assert one.score == pytest.approx(mean_squared_error(FORCE_PREDICTIONS.labels, mean), rel=1e-6)
    for one in OF_GRATINGS.ensembles:
        powers = np.exp(GRATING_PREDICTIONS.of[one.network].astype(float))
        mean = (powers / powers.sum(axis=2, keepdims=True)).mean(axis=0)
        assert one.score == pytest.approx(accuracy_score(GRATING_PREDICTIONS.labels, mean.argmax(axis=1)))
    loud = np.array([[[9.0, 0.0]], [[0.0, 2.0]], [[0.0, 2.0]]], np.float32)  # one seed is sure, two are not
    study, predictions = study_with(np.array([1]), {"baseline": loud, "variant 1": loud})
    assert image_findings(study, predictions).ensembles[0].score == 1.0


def test_differences_are_those_of_the_mean_scores() -> None:
    """Of all seeds and images, between the ends of their interval; the baseline has none."""
    for study, found in ((FORCES, OF_FORCES), (GRATINGS, OF_GRATINGS)):
        baseline, *variants = found.ensembles
        assert baseline.difference is None
        for one in variants:
            means = [study.values(name, study.primary).mean() for name in (one.network, "baseline")]
            assert one.difference is not None
            assert one.difference.estimate == pytest.approx(means[0] - means[1])
            assert one.difference.low <= one.difference.estimate <= one.difference.high


def test_every_two_networks_are_a_pair_of_one_family() -> None:
    """The later one against the earlier; Holm multiplies the smallest p by their number."""
    assert [(pair.first, pair.second) for pair in OF_FORCES.pairs] == [
        ("variant 1", "baseline"), ("variant 2", "baseline"), ("variant 2", "variant 1")
    ]  # fmt: skip
    errors = [
        ((FORCE_PREDICTIONS.of[n].mean(axis=0) - FORCE_PREDICTIONS.labels) ** 2).mean(axis=1)
        for n in ("variant 1", "baseline")
    ]
    assert OF_FORCES.pairs[0].test.p == pytest.approx(signed_rank(*errors).p, rel=1e-6)
    smallest = min(pair.test.p for pair in OF_FORCES.pairs)
    assert min(pair.p_holm for pair in OF_FORCES.pairs) == pytest.approx(3 * smallest)
    assert [pair.verdict for pair in OF_FORCES.pairs][:2] == ["better", "undecided"]
    assert [pair.verdict for pair in OF_GRATINGS.pairs] == ["better"]


def test_pairs_of_classifiers_are_mcnemars() -> None:
    """By the ensembles' right answers."""
    right = []
    for name in ("variant 1", "baseline"):
        powers = np.exp(GRATING_PREDICTIONS.of[name].astype(float))
        mean = (powers / powers.sum(axis=2, keepdims=True)).mean(axis=0)
        right.append(mean.argmax(axis=1) == GRATING_PREDICTIONS.labels)
    assert OF_GRATINGS.pairs[0].test == mcnemar(*right)


def test_outputs_are_judged_apart() -> None:
    """Variant 1 is better on Fx alone; all four pairs are one family."""
    words = {(output, pair.first): pair.verdict for output, pair in OF_FORCES.outputs}
    assert words == {
        ("Fx", "variant 1"): "better",
        ("Fx", "variant 2"): "undecided",
        ("Fy", "variant 1"): "undecided",
        ("Fy", "variant 2"): "undecided",
    }
    _, first = OF_FORCES.outputs[0]
    assert first.p_holm == pytest.approx(4 * first.test.p)
    assert first.difference.high < 0


def opposed(seeds: int, images: int = 60) -> tuple[RecordedStudy, Predictions]:
    """Make a regression whose variant has seeds that err much, each the other way: their ensemble errs little."""
    rng = np.random.default_rng(1)
    labels = rng.normal(size=(images, 2)).astype(np.float32)
    signs = np.array([1.0, -1.0] * seeds)[:seeds, None, None]
    around = {"baseline": 0.4 * rng.normal(size=(1, images, 2)), "variant 1": signs * np.array([0.5, 0.3])}
    noise = {name: 0.05 * rng.normal(size=(seeds, images, 2)) for name in around}
    return study_with(labels, {name: (labels + around[name] + noise[name]).astype(np.float32) for name in around})


@pytest.mark.parametrize("made", [forces, gratings, partial(opposed, 4), partial(opposed, 6)])
def test_no_verdict_contradicts_the_interval_beside_it(made: Callable[[], tuple[RecordedStudy, Predictions]]) -> None:
    """Better and worse stand where the interval lies on that side of 0, in every table that has both."""
    study, predictions = made()
    found = image_findings(study, predictions)
    judged = [*found.pairs, *found.against_trivial, *(pair for _, pair in found.outputs)]
    sign = -1 if study.kind is Kind.regression else 1
    for pair in judged:
        ends = (sign * pair.difference.low, sign * pair.difference.high)
        assert pair.verdict != "better" or min(ends) > 0
        assert pair.verdict != "worse" or max(ends) < 0


def test_ensemble_that_is_better_by_its_seeds_luck_is_undecided() -> None:
    """Its test alone is significant; the means of the seeds say nothing, or the opposite."""
    (pair,) = image_findings(*opposed(6)).pairs
    assert pair.test.lead > 0
    assert pair.p_holm < 0.001
    assert pair.difference.low <= 0 <= pair.difference.high or pair.difference.low > 0
    assert pair.verdict == "undecided"


@pytest.mark.parametrize(("seeds", "has_verdicts"), [(1, False), (3, False), (4, True)])
@pytest.mark.parametrize("made", [forces, gratings])
def test_no_verdict_below_the_seeds_of_a_comparison(
    made: Callable[..., tuple[RecordedStudy, Predictions]], seeds: int, has_verdicts: bool
) -> None:
    """No outcome of three seeds is significant at 0.05, and no table of the same study may say otherwise."""
    study, predictions = made(seeds=seeds)
    found = image_findings(study, predictions)
    judged = [*found.pairs, *found.against_trivial, *(pair for _, pair in found.outputs)]
    assert {pair.verdict is not None for pair in judged} == {has_verdicts}
    for table in image_tables(study, found):
        if "verdict" in table.columns:
            assert {row[-1] is not None for row in table.rows} == {has_verdicts}
            assert any("No verdicts: " in note for note in table.notes) is not has_verdicts


def test_another_variant_changes_no_interval() -> None:
    """Nor a p before its correction."""
    names = ("baseline", "variant 1")
    fewer = study_with(FORCE_PREDICTIONS.labels, {name: FORCE_PREDICTIONS.of[name] for name in names})
    found = image_findings(*fewer)
    assert found.ensembles == OF_FORCES.ensembles[:2]
    assert found.pairs[0].test == OF_FORCES.pairs[0].test


def test_residuals_are_mean_and_deviation() -> None:
    """Of prediction less label, of each seed and of the ensemble, on each output; the labels' own are the trivial's."""
    first = OF_FORCES.residuals[0]
    errors = (FORCE_PREDICTIONS.of["baseline"] - FORCE_PREDICTIONS.labels)[:, :, 0].astype(float)
    assert (first.output, first.network) == ("Fx", "baseline")
    assert first.biases == pytest.approx(errors.mean(axis=1), rel=1e-5)
    assert first.spreads == pytest.approx(errors.std(axis=1), rel=1e-5)
    assert (first.bias, first.spread) == pytest.approx((errors.mean(), errors.mean(axis=0).std()), rel=1e-5)
    assert OF_FORCES.spreads["Fy"] == pytest.approx(FORCE_PREDICTIONS.labels[:, 1].std(), rel=1e-5)


@pytest.mark.parametrize(
    ("units", "head", "squared"),
    [
        (("N", "N"), "N", "N²"),
        (("N", "mm"), "Fx N, Fy mm", "Fx N², Fy mm²"),
        (("N", ""), "Fx N, Fy as recorded", "Fx N², Fy as recorded"),
        ((), "as recorded", "as recorded"),
    ],
)
def test_errors_of_an_output_are_in_recorded_units(units: tuple[str, ...], head: str, squared: str) -> None:
    """With the unit in the head of each column, by the scale of the labels; squared errors by its square."""
    scaled, recorded = (replace(FORCES, units=units, scale=scale) for scale in ((1.0, 1.0), (2.0, 10.0)))
    before, after = (image_tables(study, OF_FORCES)[2:] for study in (scaled, recorded))
    assert after[0].columns[2] == f"difference (MSE, {squared})"
    heads = ("bias", "spread", "bias, ensemble", "spread, ensemble")
    assert after[1].columns[2:] == tuple(f"{one} ({head})" for one in heads)
    for table, factors in zip(range(2), ({"Fx": 4, "Fy": 100}, {"Fx": 2, "Fy": 10}), strict=True):
        for was, now in zip(before[table].rows, after[table].rows, strict=True):
            values = [numbers(row[2 if table == 0 else slice(2, None)]) for row in (was, now)]
            assert values[1] == pytest.approx([factors[str(was[0])] * value for value in values[0]], rel=1e-6)


def numbers(cells: Cell | tuple[Cell, ...]) -> list[float]:
    """List the numbers of cells."""
    found: list[float] = []
    for cell in cells if isinstance(cells, tuple) else (cells,):
        if isinstance(cell, Between):
            found += [cell.estimate, cell.low, cell.high]
        elif isinstance(cell, int | float):
            found.append(cell)
    return found


def test_trivial_classifier_is_calibrated() -> None:
    """It is as sure as the most frequent class is frequent, and so has no calibration error."""
    shares = np.bincount(GRATING_PREDICTIONS.labels) / len(GRATING_PREDICTIONS.labels)
    assert OF_GRATINGS.trivial is not None
    assert OF_GRATINGS.trivial.ece == 0
    assert OF_GRATINGS.trivial.accuracy == pytest.approx(shares.max())
    assert OF_GRATINGS.trivial.brier == pytest.approx(1 - (shares**2).sum())


def test_tables_hold_the_findings() -> None:
    """Each with a row for the trivial predictor where it has a score; shares are percentages."""
    ensembles, pairs, outputs, residuals = image_tables(FORCES, OF_FORCES)
    assert [table.name for table in (ensembles, pairs, outputs, residuals)] == [
        "ensembles_force", "pairs_force", "image_outputs_force", "residuals_force"
    ]  # fmt: skip
    assert [row[0] for row in ensembles.rows] == ["baseline", "variant 1", "variant 2", "trivial"]
    assert pairs.rows[0][-1] == "better"
    assert outputs.rows[0][:2] == ("Fx", "variant 1")
    assert residuals.rows[3][:3] == ("Fx", "trivial", 0)
    ensembles, pairs, calibration = image_tables(GRATINGS, OF_GRATINGS)
    difference = ensembles.rows[1][3]
    assert isinstance(difference, Between)
    assert difference.estimate > 20  # percentage points
    assert ensembles.rows[-1][2] is None
    assert isinstance(ensembles.rows[-1][1], Percent)
    assert [row[0] for row in calibration.rows] == ["baseline", "variant 1", "trivial"]
    assert "McNemar" in pairs.notes[0]


def test_each_network_meets_the_trivial_predictor_on_the_same_images() -> None:
    """By the same tests, as a family of its own, which leaves the pairs of networks their correction."""
    labels = FORCE_PREDICTIONS.labels.astype(float)
    mean = ((labels - labels.mean(axis=0)) ** 2).mean(axis=1)
    for pair in OF_FORCES.against_trivial:
        own = ((FORCE_PREDICTIONS.of[pair.first].astype(float).mean(axis=0) - labels) ** 2).mean(axis=1)
        assert pair.test.p == pytest.approx(signed_rank(own, mean).p, rel=1e-6)
    assert [pair.first for pair in OF_FORCES.against_trivial] == list(FORCE_PREDICTIONS.of)
    assert min(pair.p_holm for pair in OF_FORCES.against_trivial) == pytest.approx(
        3 * min(pair.test.p for pair in OF_FORCES.against_trivial)
    )
    classes = GRATING_PREDICTIONS.labels
    majority = classes == np.bincount(classes).argmax()
    right = GRATING_PREDICTIONS.of["baseline"].argmax(axis=2)[0] == classes
    alone = study_with(classes, {"baseline": GRATING_PREDICTIONS.of["baseline"][:1]})
    assert image_findings(*alone).against_trivial[0].test == mcnemar(right, majority)
    assert pairs_rows(OF_GRATINGS)[-2:] == [("baseline", "trivial"), ("variant 1", "trivial")]


def pairs_rows(found: ImageFindings) -> list[tuple[Cell, ...]]:
    """Name the rows of a table of pairs."""
    return [row[:2] for row in image_tables(GRATINGS, found)[1].rows]


def test_baseline_alone_is_paired_with_the_trivial_predictor_only() -> None:
    """Nor a family of nothing, which Holm refuses."""
    alone = study_with(FORCE_PREDICTIONS.labels, {"baseline": FORCE_PREDICTIONS.of["baseline"]})
    found = image_findings(*alone)
    assert (found.pairs, found.outputs) == ((), ())
    tables = image_tables(alone[0], found)
    assert [table.name for table in tables] == ["ensembles_force", "pairs_force", "residuals_force"]
    assert "alpha 0.05, over those with the trivial predictor" in tables[1].notes[-1]
    assert not any("Difference" in note for note in tables[0].notes)
