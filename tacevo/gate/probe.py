"""Tries one candidate out and measures it (child side).

What it promises: a profile means that the class was built twice with equal results, and once more with another seed,
whose draws were others; ran in train and eval mode at several batch sizes; predicted each image alike, alone and beside
others, first and again; returned what the contract asks for; took optimiser steps; and stayed within the limits. What
it does not promise: candidate code runs in this process and could forge all of this; docs/gate.md says what that gains.
"""

from dataclasses import replace
from itertools import islice
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, mse_loss

from tacevo.gate.honesty import check_names, copied_state, count_learnt, state_outside, unchanged, unwatched
from tacevo.gate.kernels import KernelWatcher, follow_the_seed
from tacevo.gate.trace import Trace, trace
from tacevo.profile import Profile
from tacevo.randomness import stream
from tacevo.records import Contract, Json, Kind, Loss, Reason, Rejection, Stage, to_json
from tacevo.sandbox.candidate import Adam, CandidateError, blaming, build, check_leaves, fault
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.module_parts import modules, parameters
from tacevo.sandbox.protocol import Header

#: Batch sizes of the two training steps; a batch of one is tried in eval mode, where batch statistics allow it.
BATCHES = (2, 5)
#: The largest batch in evaluation mode, and which of its images is predicted alone, too: one with others on both sides.
_MOST, _ALONE = 16, 2
#: Of the largest output: how far a prediction may differ beside other images. Sums in another order gave at most
#: 2.5e-7 in honest networks, and those that mix the images of a batch 1.7e-3 or more.
_ROUNDING = 1e-4
#: How often a network that draws in evaluation mode predicts one image again: one that draws in half of its passes
#: is then missed once in 256 times.
_AGAIN = 8
_SEED, _OTHER_SEED = 0, 1
#: Large enough that a part which begins at zero has an effect after one step.
_LEARNING_RATE = 1e-2


def run(header: Header, payload: bytes, arrays: Arrays, send: Send) -> list[nn.Module]:
    """Probe one candidate and send one frame, `{"profile": ...}` or `{"rejection": ...}`.

    The header has `source`, `contract` as JSON, and `limits` with the keys `parameters`, `flops` and `modules`. Return
    the networks, to be kept alive: a finaliser must not run before the answer is sent.
    """
    with KernelWatcher() as watcher:
        probe = _Probe(header, watcher)
        try:
            profile = replace(probe.profile(), not_portable=tuple(sorted(watcher.not_portable)))
            answer: dict[str, Json] = {"profile": to_json(profile)}
        except CandidateError as failure:
            rejection = Rejection(stage=Stage.probe, reason=failure.reason, detail=str(failure))
            answer = {"rejection": to_json(rejection)}
    send(answer, b"")
    return probe.built


class _Probe:
    """The trials of one candidate; `header` is as of `run`."""

    def __init__(self, header: Header, watcher: KernelWatcher) -> None:
        self._source: str = header["source"]
        self._contract = Contract.from_json(header["contract"])
        self._limits: dict[str, int] = header["limits"]
        self._watcher = watcher
        #: Every network that was made.
        self.built: list[nn.Module] = []

    def profile(self) -> Profile:
        """Run the trials, cheap ones first.

        Raises:
            CandidateError: the candidate failed one.
        """
        images, targets = _examples(self._contract)
        few, many = BATCHES
        with self._watcher.noting_draws() as draws:
            model = self._built(_SEED)
        count, weights = self._sizes(model)
        first, _ = self._step(model, images[:few], targets[:few])
        left = copied_state(model)
        flops, traced = self._evaluated(model, images)
        before = state_outside(model)
        _, flops_of_batch = self._step(model, images[:many], targets[:many])
        learnt = count_learnt(before, state_outside(model))
        self._check_size(weights, learnt)
        trained = max(-(-flops_of_batch // many), flops)
        self._check_limits(trained, traced)
        again = self._built(_SEED)
        is_same = torch.equal(self._step(again, images[:few], targets[:few])[0], first)
        if not (is_same and copied_state(again) == left):
            detail = "expected equal bits from two constructions and steps with one seed; got others"
            raise CandidateError(Reason.nondeterministic, detail)
        with self._watcher.noting_draws() as others:
            self._built(_OTHER_SEED)
        if not follow_the_seed(draws, others):
            detail = "expected initial weights that follow the trainer's seed; got equal draws under two seeds"
            raise CandidateError(Reason.fixed_seed, detail)
        return Profile(
            parameters=weights,
            flops=flops,
            modules=count,
            graph=traced.graph,
            steps=traced.steps,
            output=traced.ends,
            learnt_outside=learnt,
            extra_flops=trained - flops,
        )

    def _built(self, seed: int) -> nn.Module:
        """Construct the network once more."""
        with blaming(Reason.construction_failed):
            self.built.append(build(self._source, self._contract, seed))
        return self.built[-1]

    def _sizes(self, model: nn.Module) -> tuple[int, int]:
        """Count modules and parameters, stopping at the limits; walking a million modules takes minutes."""
        most = self._limits["modules"]
        with blaming(Reason.construction_failed):
            count = sum(1 for _ in islice(modules(model), most + 1))
            if count > most:
                raise CandidateError(Reason.too_many_modules, f"expected at most {most} modules; got more")
            check_names(model)
            listed = parameters(model)
            weights = sum(map(Tensor.numel, listed))
            self._check_size(weights, 0)
            if weights == 0:
                raise CandidateError(Reason.no_gradient, "expected trainable parameters; got none")
            for kind in (parameter.dtype for parameter in listed if not parameter.is_floating_point()):
                hint = "real and imaginary parts apart" if kind.is_complex else "what is not learnt in a buffer"
                detail = f"expected parameters of a real floating type; got {kind}; keep {hint}"
                raise CandidateError(Reason.construction_failed, detail)
        return count, weights

    def _check_size(self, weights: int, learnt: int) -> None:
        """Compare what learns with the limit: parameters, and what is learnt outside them."""
        if (size := weights + learnt) > (most := self._limits["parameters"]):
            raise CandidateError(Reason.too_many_parameters, f"expected at most {most} parameters; got {size}")

    def _check_limits(self, flops: int, traced: Trace) -> None:
        """Compare what one image took, in evaluation or in training, with the limits."""
        if flops > (most := self._limits["flops"]):
            raise CandidateError(Reason.too_many_flops, f"expected at most {most} FLOPs an image; got {flops}")
        if (nodes := len(traced.graph.nodes)) > (most := self._limits["modules"]):
            raise CandidateError(Reason.too_many_modules, f"expected at most {most} operations a pass; got {nodes}")

    def _evaluated(self, model: nn.Module, images: Tensor) -> tuple[int, Trace]:
        """Predict one image alone and beside others in eval mode, compare, and return its FLOPs and trace."""
        one, many = images[_ALONE : _ALONE + 1], BATCHES[1]
        with unchanged(model, training=False), blaming(Reason.forward_failed):
            drawn, drawn_apart = self._watcher.drawn, self._watcher.drawn_apart
            flops, traced = self._traced(model, one)
            draws = self._watcher.drawn > drawn
            self._check_limits(flops, traced)
            again = [_predicted(model, one) for _ in range(_AGAIN if draws else 1)]
            flops_of_batch, traced_batch = self._traced(model, images[:many])
            most = _predicted(model, images.flip(0))
        _check_batch(flops, traced, flops_of_batch, traced_batch, many)
        alone = [(output, 1) for output in (traced.output, *again)]
        for output, count in (*alone, (traced_batch.output, many), (most, len(images))):
            self._check_output(output, count)
        if not all(_are_near(output, traced.output) for output in again):
            reason = Reason.random_in_evaluation if draws else Reason.depends_on_batch
            detail = "expected the same prediction of an image each time in evaluation mode; got others"
            raise CandidateError(reason, detail)
        beside = traced_batch.output
        if not (_are_near(beside[_ALONE : _ALONE + 1], traced.output) and _are_near(most.flip(0)[:many], beside)):
            detail = "expected predictions that depend on their own image only; got others beside other images"
            if self._watcher.drawn_apart > drawn_apart:  # it draws the same numbers for another batch
                raise CandidateError(Reason.random_in_evaluation, f"{detail}; draw nothing in evaluation mode")
            raise CandidateError(Reason.depends_on_batch, f"{detail}; normalise by running statistics or per image")
        return flops, traced

    def _traced(self, model: nn.Module, images: Tensor) -> tuple[int, Trace]:
        """Run one traced pass; return its FLOPs, and the trace with a copy of the output."""
        before = self._watcher.flops
        traced = trace(model, images.clone())
        return self._watcher.flops - before, replace(traced, output=_copied(traced.output))

    def _step(self, model: nn.Module, images: Tensor, targets: Tensor) -> tuple[Tensor, int]:
        """Take one optimiser step and check it.

        Returns:
            A copy of the output before the step, and the FLOPs of the forward pass of the whole batch.
        """
        torch.manual_seed(_SEED)  # dropout draws the same masks in both trials, independent of what ran between
        before = self._watcher.flops
        with unchanged(model, training=True) as listed:
            with blaming(Reason.forward_failed):
                output = model(images.clone())  # as in a training, a network may write to what it gets
            flops, copy = self._watcher.flops - before, _copied(output)
            self._check_output(output, len(images))
            if not output.requires_grad:
                detail = "expected an output that depends on a trainable parameter; got one that does not"
                raise CandidateError(Reason.no_gradient, detail)
            with blaming(Reason.backward_failed):
                is_mse = self._contract.loss is Loss.mse
                loss = mse_loss(output, targets) if is_mse else cross_entropy(output, targets)
                optimiser = Adam(listed, _LEARNING_RATE)
                torch.autograd.backward(loss)
        check_leaves(output, listed)
        with blaming(Reason.backward_failed), unwatched():
            if all(parameter.grad is None for parameter in listed):
                detail = "expected gradients of the parameters after backward; got none"
                raise CandidateError(Reason.no_gradient, detail)
            optimiser.step()
            optimiser.zero_grad()
            if not all(torch.isfinite(parameter).all() for parameter in listed):
                detail = "expected finite weights after one training step; got NaN or infinity"
                raise CandidateError(Reason.not_finite, detail)
        return copy, flops

    def _check_output(self, output: object, count: int) -> None:
        """Check an output against the contract."""
        problem = fault(output, (count, self._contract.outputs))
        if problem is not None:
            raise CandidateError(Reason.bad_output, problem)
        if isinstance(output, Tensor) and not torch.isfinite(output).all():
            detail = f"expected finite outputs for a batch of {count}; got NaN or infinity"
            raise CandidateError(Reason.not_finite, detail)


def _examples(contract: Contract) -> tuple[Tensor, Tensor]:
    """Draw images and random targets, always the same for a contract.

    The images are normal noise, each with its own mean and contrast: of equal ones the features hardly differ, and
    neither do predictions that depend on the images beside.
    """
    draws = stream(_SEED, "probe")
    size = contract.image_size
    images = draws.standard_normal((_MOST, contract.in_channels, size, size), dtype="float32")
    means, contrasts = draws.uniform((-1, 0.5), (1, 1.5), (_MOST, 2)).astype("float32").T[..., None, None, None]
    images = images * contrasts + means
    if contract.kind is Kind.classification:
        return torch.from_numpy(images), torch.from_numpy(draws.integers(contract.outputs, size=_MOST))
    return torch.from_numpy(images), torch.from_numpy(draws.standard_normal((_MOST, contract.outputs), dtype="float32"))


def _predicted(model: nn.Module, images: Tensor) -> Any:
    """Run one pass without gradients; return a copy of the output."""
    with torch.no_grad():
        return _copied(model(images.clone()))


def _copied(output: Any) -> Any:
    """Copy what a network returned at once: it may be memory that the network writes to again."""
    return output.detach().clone() if type(output) is Tensor else output


def _are_near(output: Tensor, expected: Tensor) -> bool:
    """Return whether predictions of the same images are equal but for rounding."""
    return bool((output - expected).abs().max() <= _ROUNDING * expected.abs().max())


def _check_batch(flops: int, traced: Trace, flops_of_batch: int, traced_batch: Trace, count: int) -> None:
    """Check that a batch runs through the same operations as one image.

    Work on the weights alone, such as an orthogonal parametrization, is done once for any batch. So the FLOPs of a
    batch lie between those of one image and `count` times as many.
    """
    most, hint = count * flops, "do not choose by the batch size"
    if traced_batch.graph != traced.graph:
        detail = f"expected the same operations for 1 image and for {count}; got others; {hint}"
        raise CandidateError(Reason.depends_on_batch, detail)
    if not flops <= flops_of_batch <= most:
        detail = f"expected {flops} to {most} FLOPs for {count} images, of which one has {flops}; got {flops_of_batch}"
        raise CandidateError(Reason.depends_on_batch, f"{detail}; {hint}")
