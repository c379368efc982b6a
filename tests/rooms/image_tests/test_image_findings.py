"""Promise: what a study says of its test images follows from the predictions that it keeps, and from nothing else."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from kept import forces, gratings, keep, study_with
from refusals import refused
from scipy.stats import wilcoxon
from sklearn.metrics import accuracy_score, mean_squared_error
from studies import study_of

from analysis.statistics.image_statistics import signed_rank
from analysis.studies.image_findings import Predictions, image_findings, load_predictions
from analysis.table import Cell, Interval, Percent
from analysis.tables.images import image_tables
from tacevo.errors import CacheMissError, RunError
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
    loaded = load_predictions(replace(study, scores=study.scores[::-1]), tmp_path)
    assert loaded is not None
    assert list(loaded.of) == [network.name for network in study.networks]
    assert all(np.array_equal(loaded.of[name], each) for name, each in predictions.of.items())
    assert np.array_equal(loaded.labels, predictions.labels)


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
    for one in OF_FORCES[0].itertuples():
        mean = FORCE_PREDICTIONS.of[one.network].mean(axis=0)
        assert one.score == pytest.approx(mean_squared_error(FORCE_PREDICTIONS.labels, mean), rel=1e-6)
    for one in OF_GRATINGS[0].itertuples():
        powers = np.exp(GRATING_PREDICTIONS.of[one.network].astype(float))
        mean = (powers / powers.sum(axis=2, keepdims=True)).mean(axis=0)
        assert one.score == pytest.approx(accuracy_score(GRATING_PREDICTIONS.labels, mean.argmax(axis=1)))
    loud = np.array([[[9.0, 0.0]], [[0.0, 2.0]], [[0.0, 2.0]]], np.float32)  # one seed is sure, two are not
    study, predictions = study_with(np.array([1]), {"baseline": loud, "variant 1": loud})
    assert image_findings(study, predictions)[0].score[0] == 1.0


def test_differences_are_those_of_the_mean_scores() -> None:
    """Of all seeds and images, between the ends of their interval; the baseline has none."""
    for study, findings in ((FORCES, OF_FORCES), (GRATINGS, OF_GRATINGS)):
        baseline, *variants = findings[0].itertuples()
        assert np.isnan(baseline.difference)
        for one in variants:
            means = [study.values(name, study.primary).mean() for name in (one.network, "baseline")]
            assert one.difference == pytest.approx(means[0] - means[1])
            assert one.difference_low <= one.difference <= one.difference_high


def test_outputs_are_judged_apart() -> None:
    """Variant 1 is better on Fx alone; all four pairs are one family."""
    words = {(one.output, one.network): one.verdict for one in OF_FORCES[1].itertuples()}
    assert words == {
        ("Fx", "variant 1"): "better",
        ("Fx", "variant 2"): "undecided",
        ("Fy", "variant 1"): "undecided",
        ("Fy", "variant 2"): "undecided",
    }
    first = next(OF_FORCES[1].itertuples())
    assert first.p_holm == pytest.approx(4 * first.p)
    assert first.difference_high < 0
    errors = [
        (FORCE_PREDICTIONS.of[name].mean(axis=0)[:, 0] - FORCE_PREDICTIONS.labels[:, 0]) ** 2
        for name in ("variant 1", "baseline")
    ]
    assert first.p == pytest.approx(signed_rank(*errors)["p"], rel=1e-6)


def opposed(seeds: int, images: int = 60) -> tuple[RecordedStudy, Predictions]:
    """Make a regression whose variant has seeds that err much, each the other way: their ensemble errs little."""
    rng = np.random.default_rng(1)
    labels = rng.normal(size=(images, 2)).astype(np.float32)
    signs = np.array([1.0, -1.0] * seeds)[:seeds, None, None]
    around = {"baseline": 0.4 * rng.normal(size=(1, images, 2)), "variant 1": signs * np.array([0.5, 0.3])}
    noise = {name: 0.05 * rng.normal(size=(seeds, images, 2)) for name in around}
    return study_with(labels, {name: (labels + around[name] + noise[name]).astype(np.float32) for name in around})


@pytest.mark.parametrize("made", [forces, partial(opposed, 4), partial(opposed, 6)])
def test_no_verdict_contradicts_the_interval_beside_it(made: Callable[[], tuple[RecordedStudy, Predictions]]) -> None:
    """Better and worse stand where the interval lies on that side of 0."""
    for one in image_findings(*made())[1].itertuples():
        assert one.verdict != "better" or one.difference_high < 0
        assert one.verdict != "worse" or one.difference_low > 0


def test_variant_with_larger_errors_is_worse() -> None:
    """The same networks, with their names exchanged."""
    one, other = FORCE_PREDICTIONS.of["baseline"], FORCE_PREDICTIONS.of["variant 1"]
    findings = image_findings(*study_with(FORCE_PREDICTIONS.labels, {"baseline": other, "variant 1": one}))
    assert list(findings[1].verdict) == ["worse", "undecided"]


def test_ensemble_that_is_better_by_its_seeds_luck_is_undecided() -> None:
    """Its test alone is significant; the means of the seeds say nothing, or the opposite."""
    one, _ = image_findings(*opposed(6))[1].itertuples()
    assert one.lead > 0
    assert one.p_holm < 0.001
    assert one.difference_high >= 0
    assert one.verdict == "undecided"


@pytest.mark.parametrize(("seeds", "has_verdicts"), [(1, False), (3, False), (4, True)])
def test_no_verdict_below_the_seeds_of_a_comparison(seeds: int, has_verdicts: bool) -> None:
    """No outcome of three seeds is significant at 0.05, and no table of the same study may say otherwise."""
    study, predictions = forces(seeds=seeds)
    _, outputs = image_tables(study, image_findings(study, predictions))
    assert {row[-1] is not None for row in outputs.rows} == {has_verdicts}
    assert any("No verdicts: " in note for note in outputs.notes) is not has_verdicts


def test_another_variant_changes_no_interval() -> None:
    """Nor a p before its correction."""
    names = ("baseline", "variant 1")
    fewer = study_with(FORCE_PREDICTIONS.labels, {name: FORCE_PREDICTIONS.of[name] for name in names})
    findings = image_findings(*fewer)
    assert findings[0].equals(OF_FORCES[0][:2])
    assert findings[1].p[0] == OF_FORCES[1].p[0]


@pytest.mark.parametrize(
    ("units", "squared"),
    [
        (("N", "N"), "N²"),
        (("N", "mm"), "Fx N², Fy mm²"),
        (("N", ""), "Fx N², Fy as recorded"),
        ((), "as recorded"),
    ],
)
def test_errors_of_an_output_are_in_recorded_units(units: tuple[str, ...], squared: str) -> None:
    """With the unit in the head of the column, by the square of the scale of the labels."""
    before, after = (
        image_tables(replace(FORCES, units=units, scale=scale), OF_FORCES)[1] for scale in ((1.0, 1.0), (2.0, 10.0))
    )
    assert before.columns[2] == f"difference (MSE, {squared})"
    for was, now in zip(before.rows, after.rows, strict=True):
        factor = {"Fx": 4, "Fy": 100}[str(was[0])]
        assert numbers(now[2]) == pytest.approx([factor * value for value in numbers(was[2])], rel=1e-6)


def numbers(cell: Cell) -> list[float]:
    """List a difference and its ends."""
    assert isinstance(cell, Interval)
    return [cell.estimate, cell.low, cell.high]


def test_tables_hold_the_findings() -> None:
    """With a row for the trivial predictor where it has a score; shares are percentages."""
    ensembles, outputs = image_tables(FORCES, OF_FORCES)
    assert [table.name for table in (ensembles, outputs)] == ["ensembles", "image_outputs"]
    assert [row[0] for row in ensembles.rows] == ["baseline", "variant 1", "variant 2", "trivial"]
    assert outputs.rows[0][:2] == ("Fx", "variant 1")
    assert outputs.rows[0][-1] == "better"
    (ensembles,) = image_tables(GRATINGS, OF_GRATINGS)
    assert numbers(ensembles.rows[1][3])[0] > 20  # percentage points
    assert ensembles.rows[-1][2] is None
    assert isinstance(ensembles.rows[-1][1], Percent)


def test_baseline_alone_has_no_difference() -> None:
    """Nor a family of nothing, which Holm refuses."""
    alone = study_with(FORCE_PREDICTIONS.labels, {"baseline": FORCE_PREDICTIONS.of["baseline"]})
    (table,) = image_tables(alone[0], image_findings(*alone))
    assert [row[3] for row in table.rows] == [None, None]
    assert not any("Difference" in note for note in table.notes)


def grouped(study: RecordedStudy, groups: Sequence[int]) -> RecordedStudy:
    """Return a study whose test images are of these groups."""
    return replace(study, data=replace(study.data, groups=tuple(groups)))


@pytest.mark.parametrize("made", [forces, gratings])
def test_groups_of_one_image_change_no_number(made: Callable[[], tuple[RecordedStudy, Predictions]]) -> None:
    """Nor a word of the tables: nothing is said of groups that say nothing."""
    study, predictions = made()
    alone = grouped(study, range(len(predictions.labels)))
    before, after = image_findings(study, predictions), image_findings(alone, predictions)
    assert all(one.equals(other) for one, other in zip(before, after, strict=True))
    assert image_tables(alone, after) == image_tables(study, before)


def frames_of_presses(frames: int) -> tuple[RecordedStudy, Predictions]:
    """Return a regression with so many equal frames of each of 30 presses."""
    _, presses = forces(images=30)
    return study_with(
        np.repeat(presses.labels, frames, axis=0),
        {name: np.repeat(each, frames, axis=1) for name, each in presses.of.items()},
    )


def test_press_counts_once_however_many_frames_it_has() -> None:
    """No p, no count and no interval says more of three frames than of one; image by image they do."""
    presses, (study, frames) = image_findings(*frames_of_presses(1)), frames_of_presses(3)
    together, apart = (image_findings(one, frames) for one in (grouped(study, np.repeat(range(30), 3).tolist()), study))
    for name in ("better", "worse", "lead", "p", "p_holm", "verdict"):
        assert together[1][name].equals(presses[1][name])
    for table, alone, images in zip(together, presses, apart, strict=True):
        ends = ["difference_low", "difference_high"]
        assert table[ends].to_numpy() == pytest.approx(alone[ends].to_numpy(), nan_ok=True)
        widths = [(one.difference_high - one.difference_low).dropna() for one in (table, images)]
        assert (widths[0] > 1.2 * widths[1]).all()
    assert (apart[1].p < presses[1].p).all()


def test_groups_are_tested_by_the_errors_of_the_ensembles() -> None:
    """By SciPy, of the mean error of each group, which have 1 to 4 images here."""
    groups = np.repeat(range(16), [1, 2, 3, 4] * 4)
    outputs = image_findings(grouped(FORCES, groups.tolist()), FORCE_PREDICTIONS)[1]
    for one in outputs.itertuples():
        at = FORCES.names.index(one.output)
        errors = {
            name: (FORCE_PREDICTIONS.of[name].astype(float).mean(axis=0) - FORCE_PREDICTIONS.labels)[:, at] ** 2
            for name in (one.network, "baseline")
        }
        differences = errors[one.network] - errors["baseline"]
        assert one.p == pytest.approx(wilcoxon([differences[groups == each].mean() for each in range(16)]).pvalue)
        assert one.better + one.worse == 16


@pytest.mark.parametrize(("groups", "too_few"), [(7, "fewer than 8 groups"), (8, "")])
def test_tables_say_of_how_many_groups_the_images_are(groups: int, too_few: str) -> None:
    """With what so many detect, and a caution where none of the four tests can be significant: 2 / 2^8 x 4 = 0.03."""
    study = grouped(FORCES, sorted(number % groups for number in range(40)))
    ensembles, outputs = image_tables(study, image_findings(study, FORCE_PREDICTIONS))
    for table in (ensembles, outputs):
        assert any(f"40 test images of {groups} groups" in note for note in table.notes)
    told = " ".join(outputs.notes)
    assert too_few in told
    assert ("too few" in told) is bool(too_few)
    assert f"Detected by {groups} groups" in told
    assert not any("too few" in note for note in ensembles.notes)


def test_study_that_does_not_record_its_groups_warns() -> None:
    """In both tables; what to do about it stands there."""
    for table in image_tables(replace(FORCES, lacks_groups=True), OF_FORCES):
        assert any("groups" in note and "Study the run again" in note for note in table.notes)
