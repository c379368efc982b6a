"""Promise: the test metrics are those of the epoch with the lowest validation loss, and the child knows no label."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refused
from training_jobs import CONTRACT, RECIPE, SOURCE, Recorder, examples, labelled

from tacevo.choices import Numerics
from tacevo.errors import CacheMissError, DivergenceError, StoreError
from tacevo.records import DataFacts, Json, Kind, Loss, Mode, Reason, Rejection, to_json
from tacevo.rules import STUDY
from tacevo.sandbox.client import Finished, Frame
from tacevo.storage.arrays import ArrayStore, digest_of
from tacevo.storage.store import Store
from tacevo.storage.verdicts import read_verdict
from tacevo.training.evaluation import Evaluator, Examples, Setting
from tacevo.training.full import FullEvaluator, FullTraining, HeldOut, Kept, assess, read_kept

DATA = examples()
#: Of the eight images that are not trained on, five to validate and three to test on.
EXAMPLES = replace(labelled(DATA), validation=DATA.validation[:5], validation_targets=DATA.targets[DATA.validation[:5]])
HELD_OUT = HeldOut(
    rows=DATA.validation[5:], targets=DATA.targets[DATA.validation[5:]], names=("a", "b"), scale=(1.0, 2.0)
)
FACTS = DataFacts(
    fingerprint="abc",
    kind=Kind.regression,
    counts=(128, 5, 3),
    in_channels=3,
    image_size=4,
    outputs=2,
    names=HELD_OUT.names,
)
SETTING = Setting(contract=CONTRACT, fingerprint="abc", recipe=RECIPE, numerics=Numerics.portable)


def answer(offsets: list[float], *, test_offset: float = 0.0) -> Finished:
    """Write what a trainer sends whose predictions are off by so much after each epoch."""
    truth = np.concatenate([EXAMPLES.validation_targets, HELD_OUT.targets])
    frames = []
    for epoch, offset in enumerate(offsets):
        predictions = truth + np.float32(offset)
        predictions[5:] += np.float32(test_offset)
        header: Json = {"epoch": epoch, "train_loss": 0.5, "steps": 8 * (epoch + 1)}
        frames.append(Frame(header, predictions.astype(np.float32).tobytes()))
    return Finished((*frames, Frame({"weights_sha256": "0" * 64}, b"")))


ANSWER = answer([0.5, 0.25, 0.25, 1.0])


def evaluator(
    root: Path, *, outcome: Finished = ANSWER, mode: Mode = Mode.record, predictions: bool = True, **changes: Any
) -> FullEvaluator:
    """Make an evaluator of the tiny task, with some arguments changed; in a replay it has no data."""
    usual = {
        "run": Recorder(outcome).run,
        "setting": SETTING,
        "examples": (EXAMPLES, HELD_OUT) if mode is Mode.record else None,
        "rules": STUDY,
        "facts": FACTS,
        "scale": HELD_OUT.scale,
    }
    arrays = ArrayStore(Store(root, "arrays", mode)) if predictions else None
    return FullEvaluator(store=Store(root, "studies", mode), arrays=arrays, **{**usual, **changes})


def replayed(root: Path, **changes: Any) -> FullTraining | Rejection:
    """Recall the training of a store, without data."""
    return evaluator(root, mode=Mode.replay, **changes).evaluate(SOURCE, 0)


def forget_predictions(root: Path) -> None:
    """Remove the arrays of a store."""
    for path in (root / "arrays").glob("*/*"):
        path.unlink()


def judged(outcome: Finished) -> FullTraining:
    """Judge an answer that must be good."""
    verdict = assess(outcome, SETTING, EXAMPLES, HELD_OUT)
    assert not isinstance(verdict, Rejection)
    return verdict[0]


def test_epoch_of_the_lowest_validation_loss_is_tested() -> None:
    """The second of four epochs is best, and is as good as the third, which comes later."""
    verdict = judged(ANSWER)
    assert verdict.epoch == 2
    assert verdict.validation_loss == min(verdict.training.validation_losses) == pytest.approx(0.0625)
    assert verdict.metrics["mse"] == pytest.approx(0.0625)


METRICS = {"accuracy": 0.666666667, "macro_f1": 0.4, "cross_entropy": 0.693147181}


def test_classification_is_tested_by_class() -> None:
    """Equal logits cost log 2 in every epoch, and the first class wins: two of three test images are of it."""
    outcome, setting, _, (chosen_on, held_out) = classified()
    found = assess(outcome, setting, chosen_on, held_out)
    assert not isinstance(found, Rejection)
    verdict, _ = found
    assert (verdict.epoch, verdict.validation_loss) == (1, 0.693147181)
    assert verdict.metrics == METRICS
    assert verdict.confusion == ((2, 0), (1, 0))


def test_test_images_do_not_choose_the_epoch() -> None:
    """However bad the test predictions are, the validation images alone decide."""
    good, bad = judged(answer([0.5, 0.25, 0.3, 1.0])), judged(answer([0.5, 0.25, 0.3, 1.0], test_offset=9.0))
    assert (good.epoch, good.training.validation_losses) == (bad.epoch, bad.training.validation_losses)
    assert bad.metrics["mse"] > good.metrics["mse"]


def test_no_label_but_the_training_ones_leaves_the_parent(tmp_path: Path) -> None:
    """What is sent does not change with the labels of validation and test images, and does not contain them."""
    others = (
        replace(EXAMPLES, validation_targets=1 - EXAMPLES.validation_targets),
        replace(HELD_OUT, targets=1 - HELD_OUT.targets),
    )
    recorder = Recorder(ANSWER)
    for place, data in (("a", (EXAMPLES, HELD_OUT)), ("b", others)):
        evaluator(tmp_path / place, run=recorder.run, examples=data).evaluate(SOURCE, 0)
    (header, payload), second = recorder.sent
    assert second == (header, payload)
    assert set(header) == {"source", "contract", "recipe", "seed", "mean", "deviation", "train", "validation", "groups"}
    assert (header["validation"], header["groups"]) == (8, [5, 3])
    labels: NDArray[np.float32] = np.concatenate([EXAMPLES.validation_targets, HELD_OUT.targets])
    assert all(row.tobytes() not in payload for row in labels)


def test_job_of_a_search_has_no_test_row(tmp_path: Path) -> None:
    """What a search sends for the same data names the rows of training and validation images, and no other."""
    recorder = Recorder(ANSWER)
    store = Store(tmp_path, "evaluations")
    Evaluator(run=recorder.run, store=store, setting=SETTING, examples=EXAMPLES, rules=1).evaluate(SOURCE, 0)
    ((header, payload),) = recorder.sent
    named = np.frombuffer(payload, np.int64, header["train"] + header["validation"])
    assert set(named.tolist()) == {*EXAMPLES.train.tolist(), *EXAMPLES.validation.tolist()}
    assert not set(named.tolist()) & set(HELD_OUT.rows.tolist())
    assert len(payload) == named.nbytes + EXAMPLES.train_targets.nbytes


def test_recorded_training_is_recalled(tmp_path: Path) -> None:
    """A replay needs neither data nor sandbox, and reads a confusion matrix too."""
    first = evaluator(tmp_path).evaluate(SOURCE, 0)
    assert replayed(tmp_path) == first
    classified = replace(judged(answer([0.5, 0.25, 0.3, 1.0])), confusion=((1, 2), (0, 3)))
    assert read_verdict(FullTraining, "full", {"full": to_json(classified)}, place="entry") == classified


def test_predictions_that_are_not_finite_are_refused() -> None:
    """NaN for a single test image, even in an epoch that is not chosen, makes a rejection."""
    outcome = answer([0.5, 0.25, 0.3, 1.0])
    spoilt = np.frombuffer(outcome.frames[3].payload, np.float32).copy()
    spoilt[-1] = np.nan
    frames = (*outcome.frames[:3], Frame(outcome.frames[3].header, spoilt.tobytes()), outcome.frames[4])
    verdict = assess(Finished(frames), SETTING, EXAMPLES, HELD_OUT)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.not_finite


def test_keys_stay_what_they_are(tmp_path: Path) -> None:
    """A change of the question would train every recorded study again; make one on purpose only."""
    key = evaluator(tmp_path, rules=2).key("class Net: pass\n", 7)
    assert key == "040c3cd39797dff9f802a27573b999ba2ef2acb58e0c601934ac7bf762e295ba"


def test_kept_predictions_are_those_of_the_chosen_epoch(tmp_path: Path) -> None:
    """Bit for bit, for the test images alone, with their labels; an older training has none."""
    verdict = evaluator(tmp_path).evaluate(SOURCE, 0)
    assert isinstance(verdict, FullTraining)
    assert verdict.kept is not None
    predictions, labels = read_kept(ArrayStore(Store(tmp_path, "arrays", Mode.replay)), verdict.kept, FACTS)
    sent = np.frombuffer(ANSWER.frames[verdict.epoch - 1].payload, np.float32).reshape(8, 2)
    assert predictions.tobytes() == sent[5:].tobytes()
    assert np.array_equal(labels, HELD_OUT.targets)
    older = {key: value for key, value in to_json(verdict).items() if key != "kept"}
    assert read_verdict(FullTraining, "full", {"full": older}, place="entry") == replace(verdict, kept=None)


#: The digest of better test predictions, which are the labels themselves.
BETTER = digest_of(HELD_OUT.targets)


@pytest.mark.parametrize(
    ("field", "forged", "place"),
    [
        ("metrics", {"mse": 0.0}, "metrics.mse"),
        ("metrics", {"accuracy": 1.0}, "metrics.accuracy"),
        ("metrics", {"recorded_mae_b": 0.0}, "metrics.recorded_mae_b"),
        ("confusion", [[1, 0], [0, 1]], "confusion"),
        ("kept", {"predictions": BETTER}, "metrics."),
    ],
)
def test_entry_that_its_predictions_do_not_give_is_found(field: str, forged: Any, place: str, tmp_path: Path) -> None:
    """However well it is sealed: a recalled training is measured again, also where the store only reads."""
    ArrayStore(Store(tmp_path, "arrays")).keep(HELD_OUT.targets)
    forge(tmp_path, lambda full: {**full, field: {**full[field], **forged} if isinstance(forged, dict) else forged})
    for mode in (Mode.record, Mode.replay):
        with refused(DivergenceError, place=place, expected="by the test predictions"):
            evaluator(tmp_path, mode=mode).evaluate(SOURCE, 0)


def test_other_labels_are_found_where_the_data_are(tmp_path: Path) -> None:
    """A replay has no data set to compare with; the study itself does."""
    other = ArrayStore(Store(tmp_path, "arrays")).keep(HELD_OUT.targets + 1)
    forge(tmp_path, lambda full: {**full, "kept": {**full["kept"], "labels": other}})
    with refused(DivergenceError, place="kept.labels", got=other[:12]):
        evaluator(tmp_path).evaluate(SOURCE, 0)


def test_training_without_its_predictions_is_refused(tmp_path: Path) -> None:
    """Named and missing, or not named under rules that keep them."""
    forge(tmp_path, lambda full: full)
    forget_predictions(tmp_path)
    with refused(CacheMissError, place="full training", remedy="study again"):
        replayed(tmp_path)
    rewrite(tmp_path, lambda full: {**full, "kept": None})
    for predictions in (True, False):
        with refused(DivergenceError, expected="test predictions, which these rules keep"):
            replayed(tmp_path, predictions=predictions)


@pytest.mark.parametrize(
    ("forged", "place", "words"),
    [
        ({"metrics": {**METRICS, "accuracy": 1.0}}, "metrics.accuracy", "0.666666667"),
        ({"metrics": {"accuracy": 0.666666667, "macro_f1": 0.4}}, "metrics", "accuracy, cross_entropy, macro_f1"),
        ({"metrics": {**METRICS, "mse": 0.0}}, "metrics", "cross_entropy"),
        ({"confusion": [[5, -1], [-1, 0]]}, "confusion", "3 images in all"),
        ({"confusion": [[2, 0], [0, 1]]}, "metrics.accuracy", "1.0"),
        ({"confusion": [[2, 0], [0, 2]]}, "confusion", "2 rows of as many counts, 3 images in all"),
        ({"confusion": [[3]]}, "confusion", "2 rows"),
        ({"confusion": None}, "confusion", "2 rows"),
    ],
)
def test_classification_without_its_predictions_is_compared_with_its_confusion(
    forged: dict[str, Json], place: str, words: str, tmp_path: Path
) -> None:
    """What a sweep's bundle can still tell; the cross-entropy does not follow from counts."""
    outcome, setting, facts, data = classified()
    evaluator(tmp_path, outcome=outcome, setting=setting, facts=facts, examples=data).evaluate(SOURCE, 0)
    without: Any = {"setting": setting, "facts": facts, "predictions": False}
    assert isinstance(replayed(tmp_path, **without), FullTraining)
    rewrite(tmp_path, lambda full: {**full, **forged})
    with refused(DivergenceError, place=place, expected=words):
        replayed(tmp_path, **without)


def test_regression_without_its_predictions_is_taken_as_recorded(tmp_path: Path) -> None:
    """Nothing else of it says what the metrics are; it must name them all the same."""
    forge(tmp_path, lambda full: full)
    assert isinstance(replayed(tmp_path, predictions=False), FullTraining)
    rewrite(tmp_path, lambda full: {**full, "metrics": {"mse": 0.0}})
    with refused(DivergenceError, place="metrics", expected="mae", got="mse"):
        replayed(tmp_path, predictions=False)


@pytest.mark.parametrize("classes", [[0, 1, 2], [0, -1, 1]])
def test_labels_that_are_not_classes_are_refused(classes: list[int], tmp_path: Path) -> None:
    """An index beyond the last class, or before the first, which NumPy would count from the end."""
    arrays = ArrayStore(Store(tmp_path, "arrays"))
    kept = Kept(predictions=arrays.keep(np.zeros((3, 2), np.float32)), labels=arrays.keep(np.array(classes)))
    with refused(StoreError, expected="class numbers 0 to 1"):
        read_kept(arrays, kept, replace(FACTS, kind=Kind.classification))


def test_worker_cannot_report_metrics(tmp_path: Path) -> None:
    """A frame that holds any is not a trainer's; metrics follow from predictions alone."""
    first, *others = ANSWER.frames
    boasting = Frame({"epoch": 0, "train_loss": 0.5, "steps": 8, "mse": 0.0}, first.payload)
    verdict = evaluator(tmp_path, outcome=Finished((boasting, *others))).evaluate(SOURCE, 0)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.bad_output
    assert not list((tmp_path / "arrays").glob("*/*"))


def classified() -> tuple[Finished, Setting, DataFacts, tuple[Examples, HeldOut]]:
    """Return the answer, setting, facts and data of a task with two classes: equal logits, so the first class wins."""
    setting = replace(SETTING, contract=replace(CONTRACT, kind=Kind.classification, loss=Loss.cross_entropy))
    held_out = replace(HELD_OUT, targets=np.array([0, 1, 0]), scale=())
    outcome = answer([0.0] * 4)
    *frames, end = (replace(frame, payload=bytes(len(frame.payload))) for frame in outcome.frames)
    outcome = Finished((*frames, end))
    chosen_on = replace(EXAMPLES, validation_targets=np.array([1, 1, 0, 0, 1]))
    return outcome, setting, replace(FACTS, kind=Kind.classification), (chosen_on, held_out)


def forge(root: Path, change: Callable[[Any], Json]) -> None:
    """Train, and put a changed answer into the store, sealed as it should be."""
    evaluator(root).evaluate(SOURCE, 0)
    rewrite(root, change)


def rewrite(root: Path, change: Callable[[Any], Json]) -> None:
    """Put a changed answer in the place of the only one, sealed as it should be."""
    store = Store(root, "studies")
    (entry,) = store.entries()
    answer: Any = entry.answer
    store.write(entry.request, {"full": change(answer["full"])})
