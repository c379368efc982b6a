"""Tries one candidate out and measures it (child side).

What it promises: a profile means that the class was built twice with equal results, ran in train and eval mode at
several batch sizes, returned what the contract asks for, took optimiser steps, and stayed within the limits. What it
does not promise: candidate code runs in this process and could forge all of this; docs/gate.md says what that gains.
"""

from dataclasses import replace
from itertools import islice

import torch
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.nn.functional import cross_entropy, mse_loss
from torch.utils.flop_counter import FlopCounterMode, _FlopCounterMode

from tacevo.gate.honesty import check_names, unchanged
from tacevo.gate.portability import watching_portability
from tacevo.gate.trace import Trace, trace
from tacevo.profile import Profile
from tacevo.randomness import stream
from tacevo.records import Contract, Kind, Loss, Reason, Rejection, Stage, to_json
from tacevo.sandbox.candidate import Adam, CandidateError, blaming, build, call_plainly, check_leaves, digest, fault
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.network import modules, parameters
from tacevo.sandbox.protocol import Header

#: Batch sizes of the two training steps; a batch of one is tried in eval mode, where batch statistics allow it.
BATCHES = (2, 5)

call_plainly(_FlopCounterMode.__torch_dispatch__)

_SEED = 0

_LEARNING_RATE = 1e-3


def run(header: Header, payload: bytes, arrays: Arrays, send: Send) -> list[nn.Module]:
    """Probe one candidate and send one frame, `{"profile": ...}` or `{"rejection": ...}`.

    Args:
        header: `source`; `contract` as JSON; `limits` with the keys `parameters`, `flops` and `modules`.
        payload: not used.
        arrays: not used.
        send: takes the frame.

    Returns:
        The networks, to be kept alive: a finaliser must not run before the answer is sent.
    """
    built: list[nn.Module] = []
    try:
        with watching_portability() as found:
            profile = _probe(header["source"], Contract.from_json(header["contract"]), header["limits"], built)
        send({"profile": to_json(replace(profile, not_portable=tuple(sorted(found))))}, b"")
    except CandidateError as failure:
        rejection = Rejection(stage=Stage.probe, reason=failure.reason, detail=str(failure))
        send({"rejection": to_json(rejection)}, b"")
    return built


def _probe(source: str, contract: Contract, limits: dict[str, int], built: list[nn.Module]) -> Profile:
    """Run the trials, cheap ones first; each network made is added to `built`."""
    images, targets = _examples(contract)
    few, many = BATCHES
    model = _built(source, contract, built)
    count, weights = _sizes(model, limits)
    first = _training_step(model, images[:few], targets[:few], contract)
    flops, traced = _measured(model, images[:1], contract)
    _check_limits(flops, traced, limits)
    _check_batch(flops, traced, *_measured(model, images[:many], contract), many)
    _training_step(model, images[:many], targets[:many], contract)
    again = _built(source, contract, built)
    if _training_step(again, images[:few], targets[:few], contract) != first:
        raise CandidateError(
            Reason.nondeterministic, "expected equal bits from two constructions and steps with one seed; got others"
        )
    return Profile(
        parameters=weights,
        flops=flops,
        modules=count,
        graph=traced.graph,
        steps=traced.steps,
        output=traced.ends,
    )


def _examples(contract: Contract) -> tuple[Tensor, Tensor]:
    """Draw standard-normal images and random targets, always the same for a contract."""
    draws = stream(_SEED, "probe")
    count, size = max(BATCHES), contract.image_size
    images = draws.standard_normal((count, contract.in_channels, size, size), dtype="float32")
    if contract.kind is Kind.classification:
        return torch.from_numpy(images), torch.from_numpy(draws.integers(contract.outputs, size=count))
    targets = draws.standard_normal((count, contract.outputs), dtype="float32")
    return torch.from_numpy(images), torch.from_numpy(targets)


def _built(source: str, contract: Contract, built: list[nn.Module]) -> nn.Module:
    """Construct the network once more."""
    with blaming(Reason.construction_failed):
        built.append(build(source, contract, _SEED))
    return built[-1]


def _sizes(model: nn.Module, limits: dict[str, int]) -> tuple[int, int]:
    """Count modules and parameters, stopping at the limits; walking a million modules takes minutes."""
    with blaming(Reason.construction_failed):
        count = sum(1 for _ in islice(modules(model), limits["modules"] + 1))
        if count > limits["modules"]:
            raise CandidateError(Reason.too_many_modules, f"expected at most {limits['modules']} modules; got more")
        check_names(model)
        weights = sum(Tensor.numel(parameter) for parameter in parameters(model))
        if weights > limits["parameters"]:
            raise CandidateError(
                Reason.too_many_parameters, f"expected at most {limits['parameters']} parameters; got {weights}"
            )
        if weights == 0:
            raise CandidateError(Reason.no_gradient, "expected trainable parameters; got none")
    return count, weights


def _measured(model: nn.Module, images: Tensor, contract: Contract) -> tuple[int, Trace]:
    """Count the FLOPs of some images in eval mode and trace them, in one pass."""
    counter = FlopCounterMode(display=False)
    # The counter knows matrix products but not the fused attention kernel of the CPU, which it would count as 0.
    with (
        unchanged(model, training=False),
        blaming(Reason.forward_failed),
        sdpa_kernel(SDPBackend.MATH),
        counter,
    ):
        traced = trace(model, images)
    _check_output(traced.output, len(images), contract)
    return counter.get_total_flops(), traced


def _check_limits(flops: int, traced: Trace, limits: dict[str, int]) -> None:
    """Compare what one image took with the limits."""
    if flops > limits["flops"]:
        raise CandidateError(Reason.too_many_flops, f"expected at most {limits['flops']} FLOPs an image; got {flops}")
    if len(traced.graph.nodes) > limits["modules"]:
        detail = f"expected at most {limits['modules']} operations a pass; got {len(traced.graph.nodes)}"
        raise CandidateError(Reason.too_many_modules, detail)


def _check_batch(flops: int, traced: Trace, flops_of_batch: int, traced_batch: Trace, count: int) -> None:
    """Check that a batch runs through the same operations as one image.

    Work on the weights alone, such as an orthogonal parametrization, is done once for any batch. So the FLOPs of a
    batch lie between those of one image and `count` times as many.
    """
    if traced_batch.graph != traced.graph:
        detail = (
            f"expected the same operations for 1 image and for {count}; got others; do not choose by the batch size"
        )
        raise CandidateError(Reason.depends_on_batch, detail)
    if not flops <= flops_of_batch <= count * flops:
        detail = f"expected {flops} to {count * flops} FLOPs for {count} images, of which one has {flops}; "
        raise CandidateError(Reason.depends_on_batch, f"{detail}got {flops_of_batch}; do not choose by the batch size")


def _training_step(model: nn.Module, images: Tensor, targets: Tensor, contract: Contract) -> tuple[bytes, str]:
    """Take one optimiser step and check it; return the bits of the output and a hash of the weights it left."""
    torch.manual_seed(_SEED)  # dropout draws the same masks in both trials, independent of what ran between
    with unchanged(model, training=True) as listed, blaming(Reason.forward_failed):
        output = model(images)
    _check_output(output, len(images), contract)
    if not output.requires_grad:
        raise CandidateError(
            Reason.no_gradient, "expected an output that depends on a trainable parameter; got one that does not"
        )
    check_leaves(output, listed)
    with blaming(Reason.backward_failed):
        with unchanged(model, training=True):
            loss = mse_loss(output, targets) if contract.loss is Loss.mse else cross_entropy(output, targets)
            optimiser = Adam(listed, _LEARNING_RATE)
            torch.autograd.backward(loss)
        if all(parameter.grad is None for parameter in listed):
            raise CandidateError(Reason.no_gradient, "expected gradients of the parameters after backward; got none")
        optimiser.step()
        optimiser.zero_grad()
        if not all(torch.isfinite(parameter).all() for parameter in listed):
            raise CandidateError(
                Reason.not_finite, "expected finite weights after one training step; got NaN or infinity"
            )
        return output.detach().numpy().tobytes(), digest(model)


def _check_output(output: object, count: int, contract: Contract) -> None:
    """Check an output against the contract."""
    problem = fault(output, (count, contract.outputs))
    if problem is not None:
        raise CandidateError(Reason.bad_output, problem)
    if isinstance(output, Tensor) and not torch.isfinite(output).all():
        raise CandidateError(Reason.not_finite, f"expected finite outputs for a batch of {count}; got NaN or infinity")
