"""The training of one candidate, inside its sandbox: the entry `run`.

It gets the images, the training labels and the rows of the validation images, and sends back predictions. The
validation labels never come here, so a candidate cannot know how well it does. Weights are listed, switched and hashed
without calling the candidate's methods (`tacevo.sandbox.module_parts`). In the full training of a study the test images
are a second group to predict, also without labels. The parent tells after which epoch the validation loss was the
lowest so far; a copy of those weights is kept, and they predict the test images in the end. The parent trusts nothing
that leaves here, because the candidate shares this process.
"""

import math
from contextlib import nullcontext, suppress
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn.functional import cross_entropy, mse_loss

from tacevo.choices import Layout, Precision
from tacevo.randomness import derived_seed, stream
from tacevo.records import Contract, Json, Loss, Reason, Recipe
from tacevo.sandbox.candidate import (
    Adam,
    blaming,
    build,
    check_leaves,
    digest,
    fault,
    send_weights,
    standardise,
)
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.functions import portable_functions
from tacevo.sandbox.guards import CandidateError, check_shared
from tacevo.sandbox.module_parts import bits, equal, parameters, state, switch
from tacevo.sandbox.protocol import Header
from tacevo.training.captured import Capture, CapturedSteps, Step, repeats_itself
from tacevo.training.determinism import noting_nondeterminism

#: The largest difference between two layouts, in parts of the largest output: they sum in another order. No candidate
#: of the published runs, and no recorded answer, differed by a tenth of it.
_ROUNDING = 1e-4


_LAYOUTS = {Layout.contiguous: torch.contiguous_format, Layout.channels_last: torch.channels_last}
#: The number of training batches whose images are predicted at once where capturing is asked for. No gradient
#: is kept then.
_PREDICTED_AT_ONCE = 4


class _Job(NamedTuple):
    """The training that the search asked for; rows index the images."""

    source: str
    contract: Contract
    recipe: Recipe
    seed: int
    #: The images by rows of the data set, uint8: an array, or `tacevo.training.gpu.Resident`.
    images: Any
    mean: torch.Tensor
    deviation: torch.Tensor
    train: NDArray[np.int64]
    #: The rows that are predicted, in groups of which no two share a batch.
    predicted: tuple[NDArray[np.int64], ...]
    #: Whether the groups after the first are predicted in the end alone.
    last: bool
    targets: torch.Tensor
    device: torch.device
    #: The epoch, from 1, whose weights are kept and sent; None where the parent says which are kept, and none are sent.
    sent_epoch: int | None
    #: The layout of the images in memory; on a GPU of the weights, too.
    layout: torch.memory_format = torch.contiguous_format
    #: Records a step, where that is asked for.
    capture: Capture | None = None

    def inputs(self, rows: NDArray[np.int64]) -> torch.Tensor:
        """Return the network's input for some images, float32 of shape (len(rows), C, S, S)."""
        return self.standardised(torch.as_tensor(self.images[rows]).to(self.device))

    def standardised(self, stored: torch.Tensor) -> torch.Tensor:
        """Return the network's input for stored images."""
        return standardise(stored, self.mean, self.deviation).to(memory_format=self.layout)

    @property
    def is_cast(self) -> bool:
        """Whether forward passes compute in bfloat16 where torch's autocast does."""
        return self.recipe.gpu is not None and self.recipe.gpu.precision is Precision.bf16


class _Learner:
    """An optimiser, and the parameters as its last step left them: nothing else may change them while a network trains.

    On a GPU they are not compared: there each look would wait for the device. A recorded step changes nothing else.
    """

    def __init__(self, listed: list[nn.Parameter], job: _Job) -> None:
        self.listed = listed
        is_captured = job.capture is not None and job.device.type != "cpu"
        self.optimiser = Adam(listed, job.recipe.learning_rate, is_captured=is_captured)
        self._watched = listed if job.device.type == "cpu" and job.capture is None else []
        self._kept = [bits(parameter).clone() for parameter in self._watched]

    def step(self) -> None:
        """Take one step.

        Raises:
            CandidateError: something else changed a parameter, or what a step calls.
        """
        check_shared(every=False)
        self.check()
        self.optimiser.step()
        self.keep()
        self.optimiser.zero_grad()  # so that no forward pass finds a gradient to step by

    def begin(self) -> None:
        """Make the optimiser's memory as it is before a first step, which a recorded step must find."""
        for parameter in self.listed:
            parameter.grad = torch.zeros_like(parameter) if parameter.requires_grad else None
        self.optimiser.step()  # by gradients of zero, which changes no weight
        for memory in self.optimiser.state.values():
            memory["step"].zero_()
        self.optimiser.zero_grad()

    def check(self) -> None:
        """Compare the parameters' bits with those that the last step left.

        Raises:
            CandidateError: one has others.
        """
        if not all(map(equal, map(bits, self._watched), self._kept)):
            detail = "expected parameters that only the trainer's steps change; got others"
            raise CandidateError(Reason.changes_its_weights, detail)

    def keep(self) -> None:
        """Note the parameters' bits, from now on the right ones."""
        for kept, parameter in zip(self._kept, self._watched, strict=True):
            torch.Tensor.copy_(kept, bits(parameter))


def run(header: Header, payload: bytes, arrays: Arrays, send: Send) -> object:
    """Train a candidate and send one frame per epoch, then one with the digest of its weights.

    Args:
        header: `source`, `contract`, `recipe`, `seed`; `mean` and `deviation` per channel, in units of the stored
            values; `train` and `validation`, the numbers of images; `groups`, the sizes of the groups that the latter
            are divided into, by default one; `device`, by default `cpu`; `contiguous`, by default false: whether the
            images keep torch's default layout, as before number 3 of the rules; `mkl_functions`, by default false:
            whether `tacevo.sandbox.functions` is left out, as before number 5; `sent_epoch`, by default null: the
            epoch, from 1, whose weights are sent; `last`, by default false: whether only the first group is predicted
            after each epoch, and all of them in the end, with the weights of the epoch of the lowest score.
        payload: int64 rows of the training images, int64 rows of the validation images, then the training
            targets (float32 of shape (n, K), or int64 of shape (n,)).
        arrays: `images`, uint8 of shape (N, C, S, S), or what `tacevo.training.gpu.equip` made of them.
        send: for each epoch gets `{"epoch", "train_loss", "steps"}`, the last the number of optimiser steps so far,
            with the float32 predictions of the validation images, shape (n, K), row-major; with `last` then
            `{"tested": true}`, with those of all groups; then `{"weights_sha256"}`, of the last epoch, with the names
            of operations without a deterministic form under `not_deterministic`, where any ran, and with `captured`,
            whether steps were recorded and replayed, where `arrays` have `capture`; or
            `{"rejection": {"reason", "detail"}}`. The weights of `sent_epoch` come last, as
            `tacevo.sandbox.candidate.send_weights` sends them. Where `arrays` have `refused`, a training that ended
            well sends after all `{"refused"}`: how often it was refused memory of the GPU.
    """
    job, kept = _read(header, payload, arrays), None
    is_on_cpu = job.device.type == "cpu"
    has_own = is_on_cpu and not header.get("mkl_functions", False)
    try:
        with portable_functions() if has_own else nullcontext():
            if is_on_cpu and not header.get("contiguous", False):
                job, kept = _in_fast_layout(job)
            trained = _train(job, send)
        if "refused" in arrays:
            send({"refused": arrays["refused"]()}, b"")
        return kept, trained
    except CandidateError as failure:
        send({"rejection": {"reason": failure.reason.value, "detail": str(failure)}}, b"")
        return failure  # its traceback keeps the candidate's objects alive, so that their finalisers do not run


def _read(header: Header, payload: bytes, arrays: Arrays) -> _Job:
    contract, recipe = Contract.from_json(header["contract"]), Recipe.from_json(header["recipe"])
    device = torch.device(header.get("device", "cpu"))
    count, split = header["train"], header["train"] + header["validation"]
    rows = np.frombuffer(payload, np.int64, split)
    kind = np.float32 if contract.loss is Loss.mse else np.int64
    targets = np.frombuffer(payload, kind, offset=rows.nbytes).reshape((count, -1) if contract.loss is Loss.mse else -1)
    return _Job(
        source=header["source"],
        contract=contract,
        recipe=recipe,
        seed=header["seed"],
        images=arrays["images"],
        mean=torch.tensor(header["mean"], device=device)[:, None, None],
        deviation=torch.tensor(header["deviation"], device=device)[:, None, None],
        train=rows[:count],
        predicted=tuple(np.split(rows[count:], np.cumsum(header.get("groups", [header["validation"]]))[:-1])),
        targets=torch.from_numpy(targets.copy()).to(device),
        device=device,
        sent_epoch=header.get("sent_epoch"),
        last=header.get("last", False),
        layout=_LAYOUTS[recipe.gpu.layout] if recipe.gpu else torch.contiguous_format,
        capture=arrays.get("capture"),
    )


def _in_fast_layout(job: _Job) -> tuple[_Job, object]:
    """Return the job with its images in channels_last, or as it is where the candidate cannot take them so.

    A CPU's convolutions and poolings are faster there; but a `view` of such images may fail, and whatever asks how they
    lie gets another answer. So a network that does not train tries a few images in both layouts.

    Returns:
        Also what keeps this network alive, so that its finalisers do not run before the answer is sent.
    """
    fast, few = job._replace(layout=torch.channels_last), job.train[:2]
    try:
        model = build(job.source, job.contract, job.seed)
        switch(model, training=False)
        with torch.no_grad():
            expected, got = model(job.inputs(few)), model(fast.inputs(few))
        switch(model, training=True)
        trained = [weights for weights in parameters(model) if weights.requires_grad]
        torch.autograd.grad(model(fast.inputs(few)).sum(), trained, allow_unused=True)
        is_equal = bool((got - expected).abs().max() <= _ROUNDING * expected.abs().max())
        return (fast if is_equal else job), model
    except Exception as error:  # what it cannot do in either layout, its training reports
        return job, error


def _train(job: _Job, send: Send) -> nn.Module:
    """Train for all epochs; return the trained network."""
    model, learner = _made(job)
    kept: dict[str, torch.Tensor] = {}
    with noting_nondeterminism(job.device) as noted:
        with blaming(Reason.crashed):
            captured = None if job.capture is None else _captured(job, model, learner, job.capture)
        if job.capture is not None and captured is None:
            model, learner = _made(job)  # as if nothing had been tried
        for epoch in range(job.recipe.epochs):
            losses = _epoch(job, model, learner, epoch, captured)
            predictions = _predict(job, model, job.predicted[:1] if job.last else job.predicted)
            learner.check()
            # As torch itself counts them.
            steps = max((int(taken["step"]) for taken in learner.optimiser.state.values()), default=0)
            report: Json = {"epoch": epoch, "train_loss": math.fsum(losses) / len(losses), "steps": steps}
            is_lowest = send(report, predictions)
            if is_lowest or epoch + 1 == job.sent_epoch:
                kept = {name: torch.Tensor.detach(value).clone() for name, value in state(model).items()}
        with blaming(Reason.crashed):
            trained = {"weights_sha256": digest(model)}
        if job.last:
            _put_back(model, kept)
            learner.keep()
            predictions = _predict(job, model, job.predicted)
            learner.check()
            send({"tested": True}, predictions)
    with blaming(Reason.crashed):
        how = {} if job.capture is None else {"captured": captured is not None}
        send(trained | how | ({"not_deterministic": sorted(noted)} if noted else {}), b"")
        if job.sent_epoch is not None:
            send_weights(kept, send)
    return model


def _made(job: _Job) -> tuple[nn.Module, _Learner]:
    """Build the network that is trained, and what trains it."""
    with blaming(Reason.construction_failed):
        model = nn.Module.to(build(job.source, job.contract, job.seed), job.device)
        if job.device.type != "cpu" and job.layout is torch.channels_last:
            model = nn.Module.to(model, memory_format=job.layout)  # type: ignore[call-overload]
        return model, _Learner(parameters(model), job)


def _captured(job: _Job, model: nn.Module, learner: _Learner, capture: Capture) -> CapturedSteps | None:
    """Record the step of a network that is to be trained; None where its steps are to run eagerly.

    Whatever fails here, the training shows again, or does without; but memory, of which recording needs more.

    Raises:
        torch.OutOfMemoryError: the recipe's do not suffice.
    """
    first = batches(len(job.train), job.recipe.batch_size, job.seed, 0)
    places = job.images.places(job.train)

    def step_of(network: nn.Module, learner: _Learner) -> Step:
        def step(positions: torch.Tensor) -> torch.Tensor:
            inputs = job.standardised(job.images.take(places.index_select(0, positions)))
            output = _forward(job, network, inputs)
            loss = _loss(job, output, job.targets.index_select(0, positions))
            check_leaves(output, learner.listed)
            learner.optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            learner.optimiser.step()
            return loss

        return step

    try:
        other, others = _made(job)
        switch(other, training=True)
        if not repeats_itself(other, step_of(other, others), first[0], job.device):
            return None
        learner.begin()
        switch(model, training=True)
        captured = CapturedSteps.of(first, job.device, step_of(model, learner), capture)
    except torch.OutOfMemoryError:
        raise
    except Exception:
        return None
    torch.manual_seed(derived_seed(job.seed, "captured"))  # a graph counts the numbers that it draws in its own way
    return captured


def _put_back(model: nn.Module, kept: dict[str, torch.Tensor]) -> None:
    """Give a network the weights and buffers of an earlier epoch again.

    What it keeps elsewhere stays; from its predictions of the validation images the parent sees whether that matters.
    """
    # It stays as well where a buffer was made later, has another shape by now, or has values that share memory.
    with blaming(Reason.crashed), torch.no_grad(), suppress(KeyError, RuntimeError):
        for name, value in state(model).items():
            torch.Tensor.copy_(torch.Tensor.detach(value), kept[name])


def batches(count: int, size: int, seed: int, epoch: int) -> list[NDArray[np.int64]]:
    """Shuffle the positions 0..count-1 into the batches of one epoch.

    A last incomplete batch is dropped (batch normalisation cannot take one image) unless it is the only one.
    """
    order = stream(seed, "batches", epoch).permutation(count)
    full = count // size
    return [order] if full == 0 else [order[i * size : (i + 1) * size] for i in range(full)]


def _epoch(job: _Job, model: nn.Module, learner: _Learner, epoch: int, captured: CapturedSteps | None) -> list[float]:
    """Train on every batch of one epoch; return their losses."""
    switch(model, training=True)
    order = batches(len(job.train), job.recipe.batch_size, job.seed, epoch)
    if captured is not None:
        check_shared(every=False)
        return captured.epoch(order)
    return [_step(job, model, learner, positions) for positions in order]


def _step(job: _Job, model: nn.Module, learner: _Learner, positions: NDArray[np.int64]) -> float:
    """Take one step on one batch; return its loss before the step."""
    output = _forward(job, model, job.inputs(job.train[positions]))
    with blaming(Reason.backward_failed):
        loss = _loss(job, output, job.targets[positions])
        value = float(loss.detach())
        if not math.isfinite(value):
            raise CandidateError(Reason.not_finite, f"expected a finite training loss; got {value}")
        check_leaves(output, learner.listed)  # at every step: the probe's batches are smaller
        learner.optimiser.zero_grad()  # drops what a forward pass left there
        loss.backward()  # type: ignore[no-untyped-call]
        learner.step()
    return value


def _loss(job: _Job, output: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    return (mse_loss if job.contract.loss is Loss.mse else cross_entropy)(output, targets)


def _predict(job: _Job, model: nn.Module, groups: tuple[NDArray[np.int64], ...]) -> bytes:
    """Predict the images of some groups; return float32 of shape (n, K).

    Batches are of the training's size, or larger where capturing is asked for. Each output is copied at once: it may be
    memory that the network writes to again.
    """
    switch(model, training=False)
    size = job.recipe.batch_size * (1 if job.capture is None else _PREDICTED_AT_ONCE)
    parts = (rows[i : i + size] for rows in groups for i in range(0, len(rows), size))
    with torch.no_grad():
        predictions = torch.cat([_forward(job, model, job.inputs(rows)).clone() for rows in parts])
    return predictions.cpu().contiguous().numpy().tobytes()


def _forward(job: _Job, model: nn.Module, inputs: torch.Tensor) -> torch.Tensor:
    """Run the network on some images, standardised, and check its output: float32 of shape (n, K)."""
    casting = torch.autocast(job.device.type, torch.bfloat16) if job.is_cast else nullcontext()
    with blaming(Reason.forward_failed), casting:
        output: Any = model(inputs)
    if job.is_cast and type(output) is torch.Tensor and output.dtype is torch.bfloat16:
        output = output.to(torch.float32)
    check_shared(every=False)  # in each pass: what a training calls must be torch's own
    problem = fault(output, (len(inputs), job.contract.outputs))
    if problem is not None:
        raise CandidateError(Reason.bad_output, problem)
    checked: torch.Tensor = output
    return checked
