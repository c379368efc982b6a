"""Promise: the test metrics are those of the epoch with the lowest validation loss, and the child knows no label."""

from collections.abc import Callable, Iterator
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
from tacevo.records import DataFacts, Json, Kind, Limits, Loss, Mode, Reason, Rejection, to_json
from tacevo.rules import CHOSEN_SINCE, STUDY
from tacevo.sandbox.client import Died, Finished, Frame, Sandbox, Score
from tacevo.storage.array_store import ArrayStore, digest_of
from tacevo.storage.store import Store
from tacevo.storage.verdicts import read_verdict
from tacevo.training.evaluation import ENTRIES, Evaluator, Examples, Setting
from tacevo.training.full import FullEvaluator, FullTraining, HeldOut, StoredPredictions, assess_chosen, read_kept
from tacevo.training.numerics import environment

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


def answer(offsets: list[float], *, test_offset: float = 0.0, put_back: float | None = None) -> Finished:
    """Write what a trainer sends whose predictions are off by so much after each epoch, and with the weights put back.

    These are the first with the least offset, or others.
    """
    truth = np.concatenate([EXAMPLES.validation_targets, HELD_OUT.targets])
    frames = []
    for epoch, offset in enumerate(offsets):
        header: Json = {"epoch": epoch, "train_loss": 0.5, "steps": 8 * (epoch + 1)}
        frames.append(Frame(header, (truth[:5] + np.float32(offset)).tobytes()))
    tested = truth + np.float32(min(offsets) if put_back is None else put_back)
    tested[5:] += np.float32(test_offset)
    return Finished((*frames, Frame({"tested": True}, tested.tobytes()), Frame({"weights_sha256": "0" * 64}, b"")))


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
    verdict = assess_chosen(outcome, SETTING, EXAMPLES, HELD_OUT)
    assert verdict is not None
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
    judged = assess_chosen(outcome, setting, chosen_on, held_out)
    assert judged is not None
    assert not isinstance(judged, Rejection)
    verdict, _ = judged
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
    asked = {"source", "contract", "recipe", "seed", "mean", "deviation", "train", "validation", "groups", "last"}
    assert set(header) == asked
    assert (header["validation"], header["groups"], header["last"]) == (8, [5, 3], True)
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


@pytest.mark.parametrize("number", [3, 4])
def test_predictions_that_are_not_finite_are_refused(number: int) -> None:
    """NaN for a single image, even after an epoch that is not chosen, makes a rejection."""
    frames = [*ANSWER.frames]
    spoilt = np.frombuffer(frames[number].payload, np.float32).copy()
    spoilt[-1] = np.nan
    frames[number] = Frame(frames[number].header, spoilt.tobytes())
    verdict = assess_chosen(Finished(tuple(frames)), SETTING, EXAMPLES, HELD_OUT)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.not_finite


@pytest.mark.parametrize(
    "forge", [lambda one: [], lambda one: [one, one], lambda one: [Frame(one.header, one.payload[:-8])]]
)
def test_test_images_are_predicted_once(forge: Callable[[Frame], list[Frame]]) -> None:
    """Never, twice, or not all of them: a rejection."""
    *epochs, tested, end = ANSWER.frames
    verdict = assess_chosen(Finished((*epochs, *forge(tested), end)), SETTING, EXAMPLES, HELD_OUT)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.bad_output


def test_score_is_the_loss_of_an_epoch_and_nothing_else(tmp_path: Path) -> None:
    """Whatever else is sent, and what is not finite, is never the lowest."""
    nan = Frame({}, np.full(10, np.nan, np.float32).tobytes())
    recorder = Recorder(Finished((*ANSWER.frames, nan, Frame({}, b"abc"))))
    evaluator(tmp_path, run=recorder.run).evaluate(SOURCE, 0)
    assert recorder.scores == [[*judged(ANSWER).training.validation_losses, *[np.inf] * 4]]


def test_surplus_frames_get_no_bit(tmp_path: Path) -> None:
    """A candidate that sends fifty frames, each better and each called the first epoch, hears of as many as epochs."""
    np.save(tmp_path / "images.npy", DATA.images)
    entries, arrays = {"train": "attacks:send_better_and_better"}, {"images": tmp_path / "images.npy"}
    with Sandbox(entries=entries, environment=environment(Numerics.portable), arrays=arrays) as sandbox:
        outcome = SETTING.train(sandbox.run, SOURCE, 0, examples=EXAMPLES, predicted=[EXAMPLES.validation], last=True)
    assert isinstance(outcome, Finished)
    assert outcome.frames[-1].header == [True] * RECIPE.epochs + [False] * (50 - RECIPE.epochs)
    verdict = assess_chosen(outcome, SETTING, EXAMPLES, HELD_OUT)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is Reason.bad_output


#: A network whose buffers follow the training images, as a batch normalisation's do.
NORMALISED = """
class Net(nn.Module):
    def __init__(self, in_channels=3, num_outputs=2):
        super().__init__()
        self.body = nn.Sequential(nn.Conv2d(in_channels, 8, 3), nn.BatchNorm2d(8), nn.ReLU(), nn.Flatten())
        self.head = nn.Linear(32, num_outputs)

    def forward(self, x):
        return self.head(self.body(x))
"""

#: One that learns outside its weights and buffers, too: in a list.
LEARNING_OUTSIDE = """
class Net(nn.Module):
    def __init__(self, in_channels=3, num_outputs=2):
        super().__init__()
        self.head = nn.Linear(48, num_outputs)
        self.seen = [torch.zeros(48)]

    def forward(self, x):
        x = x.flatten(1)
        if self.training:
            self.seen[0] = 0.9 * self.seen[0] + 0.1 * x.detach().mean(0)
        return self.head(x - self.seen[0])
"""


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sandbox]:
    """Open one sandbox for all trainings."""
    images = tmp_path_factory.mktemp("sandbox") / "images.npy"
    np.save(images, DATA.images)
    with Sandbox(entries=ENTRIES, environment=environment(Numerics.portable), arrays={"images": images}) as opened:
        yield opened


@pytest.mark.few(1)
@pytest.mark.parametrize(("source", "jobs"), [(SOURCE, 1), (NORMALISED, 1), (LEARNING_OUTSIDE, 2)])
def test_later_rules_test_the_same_predictions(source: str, jobs: int, sandbox: Sandbox, tmp_path: Path) -> None:
    """Bit for bit as if test images were predicted after every epoch, and the training is that of a search."""
    setting = replace(SETTING, recipe=replace(RECIPE, epochs=8, learning_rate=5e-2))
    sent: list[object] = []

    def run(entry: str, header: Any, payload: bytes, limits: Limits, score: Score | None = None) -> Finished | Died:
        sent.append(header)
        return sandbox.run(entry, header, payload, limits, score)

    asked: Any = {"run": run, "setting": setting}
    evaluators = [evaluator(tmp_path / f"{rules}", rules=rules, **asked) for rules in (CHOSEN_SINCE - 1, STUDY)]
    before, now = (each.evaluate(source, 1) for each in evaluators)
    assert [each.twice for each in evaluators] == [set(), {(source, 1)} if jobs == 2 else set()]
    store = Store(tmp_path, "evaluations")
    searched = Evaluator(store=store, examples=EXAMPLES, rules=4, **asked).evaluate(source, 1)
    assert isinstance(before, FullTraining)
    assert isinstance(now, FullTraining)
    assert now.epoch < setting.recipe.epochs  # else nothing is put back
    assert now.training == searched
    assert now == replace(before, training=now.training)
    assert len(sent) == 1 + jobs + 1


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
    sent = np.frombuffer(ANSWER.frames[4].payload, np.float32).reshape(8, 2)
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
    kept = StoredPredictions(
        predictions=arrays.keep(np.zeros((3, 2), np.float32)), labels=arrays.keep(np.array(classes))
    )
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
    outcome = Finished(tuple(replace(frame, payload=bytes(len(frame.payload))) for frame in outcome.frames))
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
