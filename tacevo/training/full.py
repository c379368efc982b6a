"""The full training of a study: all epochs, then the test metrics of the epoch with the lowest validation loss.

The child predicts the validation images after every epoch, and hears whether their loss was the lowest so far. In the
end it puts those weights back and predicts validation and test images, in separate batches. All of it is without their
labels: the parent chooses the epoch. Where it predicts the validation images otherwise than after that epoch, as a
network does that keeps what it learnt outside its weights and buffers, it is trained again and predicts the test images
after every epoch, as all did under the rules before `CHOSEN_SINCE`. In a network that normalises by the batch no test
image changes a validation loss. A candidate that counts its calls could answer the test images alone by other weights
(docs/security.md).

The test predictions of that epoch are kept with the labels of the test images, and the metrics are computed from them
again whenever a training is recalled. Where they are not at hand, in the bundle of a sweep, those metrics are computed
that follow from the confusion.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacevo.errors import CacheMissError, DivergenceError, StoreError
from tacevo.records import DataFacts, Kind, Reason, Record, Rejection, Stage, Training
from tacevo.rules import CHOSEN_SINCE, KEPT_SINCE
from tacevo.sandbox.client import Died, Finished, RunJob
from tacevo.sandbox.protocol import one_line
from tacevo.storage.array_store import ArrayStore, digest_of
from tacevo.storage.store import Store
from tacevo.text import listed
from tacevo.training.evaluation import Examples, Setting, TrainingStore
from tacevo.training.metrics import (
    Confusion,
    classification_metrics,
    confusion,
    contradiction,
    metric_names,
    regression_metrics,
)

#: Header of the frame with the predictions of the weights that were put back.
_TESTED = {"tested": True}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """The test images: their rows and labels, which no search has."""

    #: Int64, shape (t,).
    rows: NDArray[np.int64]
    #: Float32 of shape (t, K) for regression; int64 of shape (t,), each in [0, K), for classification.
    targets: NDArray[Any]
    #: The names of the regressed values or classes, K.
    names: tuple[str, ...]
    #: Units of the recording for one unit of training, K; empty for classification.
    scale: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredPredictions(Record):
    """The SHA-256 of a full training's test predictions and labels, under which the store keeps the arrays."""

    #: The digest of the predictions of the chosen epoch, float32, shape (t, K), in the scaled units of training, or
    #: logits.
    predictions: str
    #: The digest of the labels of the test images, float32 of shape (t, K) in the same units, or int64 classes of shape
    #: (t,).
    labels: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FullTraining(Record):
    """A full training, and the test metrics of its best epoch."""

    #: The training, as of a search with so many epochs; its `weights_sha256` is of the last one. Before `CHOSEN_SINCE`
    #: its `predictions_sha256` covers the test images, too.
    training: Training
    #: The epoch of the lowest validation loss, from 1; the first one on a tie.
    epoch: int
    #: The metrics by name, see `training.metrics`.
    metrics: dict[str, float]
    #: The confusion matrix; None for regression.
    confusion: Confusion | None
    #: The stored predictions and labels; None under the rules before `KEPT_SINCE`.
    kept: StoredPredictions | None = None

    @property
    def validation_loss(self) -> float:
        """The validation loss of the chosen epoch."""
        return self.training.validation_losses[self.epoch - 1]


class FullEvaluator(TrainingStore[tuple[Examples, HeldOut], FullTraining]):
    """The full trainings of studies, in a store of the kind `studies`; their rules are `tacevo.rules.STUDY`.

    `arrays` keeps the test predictions, or is None where no training is stored and they are not at hand. `facts` are
    those of the data set, and `scale` is that of `HeldOut`.
    """

    _result, _name = FullTraining, "full"

    def __init__(
        self,
        *,
        run: RunJob,
        store: Store,
        setting: Setting,
        examples: tuple[Examples, HeldOut] | None,
        rules: int,
        arrays: ArrayStore | None,
        facts: DataFacts,
        scale: Sequence[float],
    ) -> None:
        super().__init__(run=run, store=store, setting=setting, examples=examples, rules=rules)
        self._arrays, self._facts, self._scale = arrays, facts, scale

    def evaluate(self, source: str, seed: int) -> FullTraining | Rejection:
        """Train a network with a seed or recall how its training went, and compute its metrics again.

        Raises:
            TacevoError: as `TrainingStore.evaluate`.
            CacheMissError: the store has the training, and lacks its test predictions.
            DivergenceError: its metrics are not those of its predictions or of its confusion, or it names no
                predictions; or the labels that it names are not those of the examples.
        """
        verdict = super().evaluate(source, seed)
        if isinstance(verdict, FullTraining) and self._rules >= KEPT_SINCE:
            self._check(verdict, f"full training {self.key(source, seed)[:12]}")
        return verdict

    def _train(self, data: tuple[Examples, HeldOut], source: str, seed: int) -> FullTraining | Rejection:
        examples, held_out = data
        predicted = [examples.validation, held_out.rows]
        is_chosen, verdict = self._rules >= CHOSEN_SINCE, None
        if is_chosen:
            outcome = self._setting.train(self._run, source, seed, examples=examples, predicted=predicted, last=True)
            verdict = assess_chosen(outcome, self._setting, examples, held_out)
        if verdict is None:
            if is_chosen:
                self.twice.add((source, seed))
            outcome = self._setting.train(self._run, source, seed, examples=examples, predicted=predicted)
            verdict = assess(outcome, self._setting, examples, held_out, hashes_tests=not is_chosen)
        if isinstance(verdict, Rejection):
            return verdict
        training, predictions = verdict
        if self._arrays is not None:  # it is where the training is not stored, either
            self._arrays.keep(held_out.targets)  # before the training is, so that it never names what is not there
            self._arrays.keep(predictions)
        return training

    def _check(self, verdict: FullTraining, place: str) -> None:
        """Compute the metrics of a training from what it keeps, and compare."""
        if verdict.kept is None:
            got = f"a training under rules {self._rules} that names none"
            raise DivergenceError(got, place=place, expected="test predictions, which these rules keep")
        if self._examples is not None and (ours := digest_of(self._examples[1].targets)) != verdict.kept.labels:
            expected = f"{ours[:12]}, the digest of the labels of the test images"
            raise DivergenceError(verdict.kept.labels[:12], place=f"{place}, kept.labels", expected=expected)
        if self._arrays is None:
            _check_counts(verdict, self._facts, place)
            return
        try:
            predictions, labels = read_kept(self._arrays, verdict.kept, self._facts)
        except CacheMissError as error:
            error.place = f"{place}, {error.place}"
            error.remedy = "restore it; or delete that training from the store, and study again"
            raise
        metrics, counts = score(self._facts.kind, predictions, labels, names=self._facts.names, scale=self._scale)
        if counts != verdict.confusion:
            expected = f"{counts}, by the test predictions"
            raise DivergenceError(f"{verdict.confusion}", place=f"{place}, confusion", expected=expected)
        _compare(verdict.metrics, metrics, place, "the test predictions")


def _check_counts(verdict: FullTraining, facts: DataFacts, place: str) -> None:
    """Compare the metrics with each other, and of a classification with the confusion; their names, too."""
    if verdict.metrics.keys() != (names := metric_names(facts.kind, facts.names)):
        got, expected = listed(sorted(verdict.metrics)), listed(sorted(names))
        raise DivergenceError(got, place=f"{place}, metrics", expected=expected)
    found = contradiction(facts.kind, facts.names, verdict.metrics, verdict.confusion, images=facts.counts[2])
    if found is not None:
        what, got, expected = found
        raise DivergenceError(got, place=f"{place}, {what}", expected=expected)


def _compare(recorded: Mapping[str, float], computed: Mapping[str, float], place: str, basis: str) -> None:
    """Compare metrics with those that were computed from something else, by name."""
    for name in sorted(computed.keys() | recorded.keys()):
        if computed.get(name) != recorded.get(name):
            expected = f"{computed.get(name)}, by {basis}"
            raise DivergenceError(str(recorded.get(name)), place=f"{place}, metrics.{name}", expected=expected)


def assess(
    outcome: Finished | Died, setting: Setting, examples: Examples, held_out: HeldOut, *, hashes_tests: bool
) -> tuple[FullTraining, NDArray[np.float32]] | Rejection:
    """Choose the epoch of the lowest validation loss, the first on a tie, and compute its test metrics.

    The predictions of each epoch are those of the validation images, then of the test images. `hashes_tests` says
    whether the digest of the training covers both.

    Returns:
        The training, and its predictions for the test images, shape (t, K).
    """
    count = len(examples.validation)
    verdict = setting.judge(outcome, examples, rows=count + len(held_out.rows))
    if isinstance(verdict, Rejection):
        return verdict
    training, of_epochs = verdict
    predictions = of_epochs[_lowest(training)][count:]
    if not hashes_tests:
        training = untested(training, of_epochs, count)
    return _tested(training, predictions, setting, held_out), predictions


def assess_chosen(
    outcome: Finished | Died, setting: Setting, examples: Examples, held_out: HeldOut
) -> tuple[FullTraining, NDArray[np.float32]] | Rejection | None:
    """Do what `assess` does, where the test images are predicted last.

    Returns:
        None where the validation images are predicted otherwise then than after the chosen epoch: the weights that were
        put back are not all of that network.
    """
    sent: list[bytes] = []
    if isinstance(outcome, Finished):
        sent = [frame.payload for frame in outcome.frames if frame.header == _TESTED]
        outcome = replace(outcome, frames=tuple(frame for frame in outcome.frames if frame.header != _TESTED))
    count, rows = len(examples.validation), len(examples.validation) + len(held_out.rows)
    verdict = setting.judge(outcome, examples, rows=count)
    if isinstance(verdict, Rejection):
        return verdict
    training, of_epochs = verdict
    try:
        [payload] = sent
        predictions = np.frombuffer(payload, np.float32).reshape(rows, setting.contract.outputs)
    except ValueError as error:
        return Rejection(stage=Stage.train, reason=Reason.bad_output, detail=one_line(str(error)))
    validated, predictions = predictions[:count], predictions[count:]
    if validated.tobytes() != of_epochs[_lowest(training)].tobytes():
        return None
    if not np.isfinite(predictions).all():
        detail = "the test predictions are not all finite"
        return Rejection(stage=Stage.train, reason=Reason.not_finite, detail=detail)
    return _tested(training, predictions, setting, held_out), predictions


def untested(training: Training, of_epochs: Sequence[NDArray[np.float32]], count: int) -> Training:
    """Return a training as of a search: its digest covers the first predictions of each epoch alone, so many."""
    validated = b"".join(values[:count].tobytes() for values in of_epochs)
    return replace(training, predictions_sha256=hashlib.sha256(validated).hexdigest())


def _lowest(training: Training) -> int:
    """Return the epoch of the lowest validation loss, from 0; the first on a tie."""
    return training.validation_losses.index(min(training.validation_losses))


def _tested(training: Training, predictions: NDArray[np.float32], setting: Setting, held_out: HeldOut) -> FullTraining:
    """Compute the test metrics of the chosen epoch's predictions."""
    kind = setting.contract.kind
    metrics, counts = score(kind, predictions, held_out.targets, names=held_out.names, scale=held_out.scale)
    return FullTraining(
        training=training,
        epoch=_lowest(training) + 1,
        metrics=metrics,
        confusion=counts,
        kept=StoredPredictions(predictions=digest_of(predictions), labels=digest_of(held_out.targets)),
    )


def read_kept(
    arrays: ArrayStore, kept: StoredPredictions, facts: DataFacts
) -> tuple[NDArray[np.float32], NDArray[Any]]:
    """Read the test predictions of a training, and the labels of the test images of its data set.

    Returns:
        Predictions, shape (t, K), finite; labels as in `HeldOut`, finite, or each in [0, K).

    Raises:
        CacheMissError: the store lacks them.
        StoreError: they are damaged, or a label is not a class.
    """
    images, outputs = facts.counts[2], facts.outputs
    predictions = arrays.read(kept.predictions, "<f4", (images, outputs))
    if facts.kind is Kind.regression:
        return predictions, arrays.read(kept.labels, "<f4", (images, outputs))
    labels = arrays.read(kept.labels, "<i8", (images,))
    if (wrong := labels[(labels < 0) | (labels >= outputs)]).size:
        place, expected = f"the test labels {kept.labels[:12]}", f"class numbers 0 to {outputs - 1}"
        raise StoreError(f"{wrong[0]}", place=place, expected=expected)
    return predictions, labels


def score(
    kind: Kind, predictions: NDArray[np.float32], labels: NDArray[Any], *, names: Sequence[str], scale: Sequence[float]
) -> tuple[dict[str, float], Confusion | None]:
    """Compute the test metrics of predictions, and of a classification the confusion; see `training.metrics`."""
    if kind is Kind.classification:
        return classification_metrics(predictions, labels), confusion(predictions, labels)
    return regression_metrics(predictions, labels, names=names, scale=scale), None
