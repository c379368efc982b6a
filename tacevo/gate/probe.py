"""Tries one candidate out and measures it (child side).

What it promises: a profile means that the class was built twice with equal results, at other addresses, and once more
with another seed, whose draws were others; ran in train and eval mode at several batch sizes, on noise and on images of
the data set where there is one; predicted each image alike, alone and beside others, first and again; returned what the
contract asks for; took the optimiser's steps and no others; and stayed within the limits. What it does not promise:
candidate code runs in this process and could forge all of this; docs/gate.md says what that gains.
"""

from copy import deepcopy
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, mse_loss

from tacevo.gate.honesty import check_names, copied_state, count_learnt, state_outside, unchanged, unwatched
from tacevo.gate.kernels import KernelWatcher, follow_the_seed, too_often
from tacevo.gate.trace import Trace, trace
from tacevo.profile import Profile
from tacevo.randomness import derived_seed, stream
from tacevo.records import Contract, Json, Kind, Loss, Reason, Rejection, Stage, to_json
from tacevo.sandbox.candidate import Adam, blaming, build, check_leaves, fault, standardise
from tacevo.sandbox.child import Arrays, Send
from tacevo.sandbox.functions import portable_functions
from tacevo.sandbox.guards import CandidateError
from tacevo.sandbox.module_parts import bits, equal, graph_nodes, modules, parameters
from tacevo.sandbox.protocol import Header

#: Batch sizes of the two training steps; a batch of one is tried in eval mode, where batch statistics allow it.
BATCHES = (2, 5)
#: The largest batch in evaluation mode, and which of its images is predicted alone, too: one with others on both sides.
_MOST, _ALONE = 16, 2
#: The largest difference of a prediction beside other images, in parts of the largest output. Sums in another order
#: gave at most 2.5e-7 in honest networks, and those that mix the images of a batch 1.7e-3 or more.
_ROUNDING = 1e-4
#: The number of times that a network predicts one image again which may draw in evaluation mode: one that draws in half
#: of its passes is then missed once in 256 times.
_AGAIN = 8
#: Seed of the probe's images and targets.
_SEED = 0
#: Sizes of objects for which Python keeps memory of its own, in bytes, and how many of each move what comes after them.
_SIZES, _MOVING = range(48, 513, 16), 13
#: Large enough that a part which begins at zero has an effect after one step.
_LEARNING_RATE = 1e-2


def run(header: Header, payload: bytes, arrays: Arrays, send: Send) -> list[nn.Module]:
    """Probe one candidate and send one frame, `{"profile": ...}` or `{"rejection": ...}`.

    The header has `source`, `contract` as JSON, and `limits` with the keys `parameters`, `flops` and `modules`. For a
    data set it also has `mean` and `deviation` per channel, in units of the stored values; then the payload is int64
    rows of `images` in the arrays, 16 of them, uint8 of shape (N, C, S, S). Return the networks, to be kept alive: a
    finaliser must not run before the answer is sent.
    """
    with portable_functions(), KernelWatcher() as watcher:
        probe = _Probe(header, watcher, _of_data(header, payload, arrays))
        try:
            profile = replace(probe.profile(), not_portable=tuple(sorted(watcher.not_portable)))
            answer: dict[str, Json] = {"profile": to_json(profile)}
        except CandidateError as failure:
            rejection = Rejection(stage=Stage.probe, reason=failure.reason, detail=str(failure))
            answer = {"rejection": to_json(rejection)}
    send(answer, b"")
    return probe.built


class _Probe:
    """The trials of one candidate; `header` is as of `run`, `of_data` are images of the data set, standardised."""

    def __init__(self, header: Header, watcher: KernelWatcher, of_data: Tensor | None) -> None:
        self._source: str = header["source"]
        # Of its own text a network does not know the hash, so it cannot tell the probe by what it draws first.
        self._seed, self._other_seed = (derived_seed(0, "probe", self._source, number) for number in range(2))
        self._contract = Contract.from_json(header["contract"])
        self._limits: dict[str, int] = header["limits"]
        self._watcher = watcher
        self._of_data = of_data
        #: Every network that was made.
        self.built: list[nn.Module] = []
        self._moved: list[object] = []

    def profile(self) -> Profile:
        """Run the trials, cheap ones first.

        Raises:
            CandidateError: the candidate failed one.
        """
        images, targets = _examples(self._contract)
        few, many = BATCHES
        with self._watcher.noting_draws() as draws:
            model = self._built(self._seed)
        count, weights = self._sizes(model)
        first, _ = self._step(model, images[:few], targets[:few])
        left = copied_state(model)
        flops, traced = self._evaluated(model, images)
        later = images if self._of_data is None else self._of_data
        before = state_outside(model)
        flops_of_batch = self._later_step(model, later[:many], targets[:many])
        learnt = count_learnt(before, state_outside(model))
        self._check_size(weights, learnt)
        trained = max(-(-flops_of_batch // many), flops)
        self._check_limits(trained, traced)
        self._move_memory()
        again = self._built(self._seed)
        is_same = torch.equal(self._step(again, images[:few], targets[:few])[0], first)
        if not (is_same and copied_state(again) == left):
            detail = "expected equal bits from two constructions and steps with one seed; got others"
            raise CandidateError(Reason.nondeterministic, detail)
        self._move_memory()
        with self._watcher.noting_draws() as others:
            other = self._built(self._other_seed)
        if [*map(_form, parameters(other))] != [*map(_form, parameters(again))]:
            detail = "expected parameters of equal shapes from two constructions; got others"
            raise CandidateError(Reason.nondeterministic, detail)
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

    def _move_memory(self) -> None:
        """Have what the candidate makes from now on lie elsewhere.

        Addresses are the same in every process, but not on every machine, and texts show them: `str(object())`.
        """
        self._moved += [object() for _ in range(_MOVING)]
        self._moved += [bytes(size - 33) for size in _SIZES for _ in range(_MOVING)]  # 33 bytes are its header

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
        """Predict one image alone and beside others in eval mode, compare, and return its FLOPs and trace.

        Where there are images of the data set, these are, and lie in memory as in a training; noise is predicted alone
        and among the most.
        """
        one, many = images[_ALONE : _ALONE + 1], BATCHES[1]
        shown = images if self._of_data is None else self._of_data
        every = images if self._of_data is None else torch.cat([shown[:many], images])[:_MOST]
        with unchanged(model, training=False), blaming(Reason.forward_failed):
            drawn, drawn_apart = self._watcher.drawn, self._watcher.drawn_apart
            flops, noise = self._traced(model, one)
            draws = self._watcher.drawn > drawn
            self._check_limits(flops, noise)
            self._move_memory()
            again = [_predicted(model, one) for _ in range(_AGAIN if draws else 1)]
            flops_alone, alone = flops, noise
            if self._of_data is not None:
                shown = self._of_data = self._as_in_training(model, self._of_data)
                flops_alone, alone = self._traced(model, shown[_ALONE : _ALONE + 1])
            flops_of_batch, batch = self._traced(model, shown[:many])
            most = _predicted(model, every.flip(0))
        if (alone.graph, flops_alone) != (noise.graph, flops):
            expected = f"expected the operations that the probe's noise takes, {flops} FLOPs, for an image of the data"
            detail = f"{expected}; got others, {flops_alone} FLOPs; do not choose by what it shows or how it lies"
            raise CandidateError(Reason.depends_on_batch, detail)
        _check_batch(flops_alone, alone, flops_of_batch, batch, many)
        single = [(output, 1) for output in (noise.output, *again, alone.output)]
        for output, count in (*single, (batch.output, many), (most, len(every))):
            self._check_output(output, count)
        if not all(_are_near(output, noise.output) for output in again):
            reason = Reason.random_in_evaluation if draws else Reason.depends_on_batch
            detail = "expected the same prediction of an image each time in evaluation mode; got others"
            raise CandidateError(reason, detail)
        beside, most = batch.output, most.flip(0)
        pairs = [(beside[_ALONE], alone.output[0]), (most[:many], beside)]
        if self._of_data is not None:
            pairs.append((most[many + _ALONE], noise.output[0]))
        if not all(_are_near(output, expected) for output, expected in pairs):
            detail = "expected predictions that depend on their own image only; got others beside other images"
            if self._watcher.drawn_apart > drawn_apart:  # it draws the same numbers for another batch
                raise CandidateError(Reason.random_in_evaluation, f"{detail}; draw nothing in evaluation mode")
            raise CandidateError(Reason.depends_on_batch, f"{detail}; normalise by running statistics or per image")
        return flops, noise

    def _as_in_training(self, model: nn.Module, images: Tensor) -> Tensor:
        """Return images that lie in memory as a training's do: in channels_last, if the network takes them so."""
        fast = images.to(memory_format=torch.channels_last)
        try:
            _predicted(model, fast[:2])
        except Exception:  # its training uses the other layout then
            return images
        return fast

    def _traced(self, model: nn.Module, images: Tensor) -> tuple[int, Trace]:
        """Run one traced pass; return its FLOPs, and the trace with a copy of the output."""
        before = self._watcher.flops
        traced = trace(model, images.clone())
        return self._watcher.flops - before, replace(traced, output=_copied(traced.output))

    def _later_step(self, model: nn.Module, images: Tensor, targets: Tensor) -> int:
        """Take a step that is compared with another optimiser's, and return the FLOPs of its forward pass.

        A network may take the layout of a training in evaluation only; its training uses the other one then.
        """
        try:
            return self._step(model, images, targets, compared=True)[1]
        except CandidateError as failure:
            if images.is_contiguous() or failure.reason not in (Reason.forward_failed, Reason.backward_failed):
                raise
        return self._step(model, images.contiguous(), targets, compared=True)[1]

    def _step(self, model: nn.Module, images: Tensor, targets: Tensor, *, compared: bool = False) -> tuple[Tensor, int]:
        """Take one optimiser step and check it; `compared` with one that an optimiser of our own takes, too.

        Returns:
            A copy of the output before the step, and the FLOPs of the forward pass of the whole batch.
        """
        torch.manual_seed(self._seed)  # dropout draws the same masks in both trials, independent of what ran between
        before = self._watcher.flops
        self._watcher.backward.clear()
        with unchanged(model, training=True) as listed:
            with blaming(Reason.forward_failed):
                output = model(images.clone())  # as in a training, a network may write to what it gets
            flops, copy = self._watcher.flops - before, _copied(output)
            self._check_backward("a forward pass without a backward pass", min(self._watcher.backward, default=None))
            self._check_output(output, len(images))
            if not output.requires_grad:
                detail = "expected an output that depends on a trainable parameter; got one that does not"
                raise CandidateError(Reason.no_gradient, detail)
            with blaming(Reason.backward_failed):
                is_mse = self._contract.loss is Loss.mse
                loss = mse_loss(output, targets) if is_mse else cross_entropy(output, targets)
                optimiser = Adam(listed, _LEARNING_RATE)
                torch.autograd.backward(loss)
            self._check_backward("one backward pass", too_often(self._watcher.backward, graph_nodes(loss)))
        check_leaves(output, listed)
        with blaming(Reason.backward_failed), unwatched():
            if all(parameter.grad is None for parameter in listed):
                detail = "expected gradients of the parameters after backward; got none"
                raise CandidateError(Reason.no_gradient, detail)
            expected = _stepped(listed) if compared else []
            optimiser.step()
            optimiser.zero_grad()
            if not all(map(equal, map(bits, expected), map(bits, listed))):
                detail = "expected the parameters that one step of Adam gives; got others"
                raise CandidateError(Reason.learns_by_itself, detail)
            if not all(map(_is_finite, listed)):
                detail = "expected finite weights after one training step; got NaN or infinity"
                raise CandidateError(Reason.not_finite, detail)
        return copy, flops

    def _check_backward(self, expected: str, kernel: str | None) -> None:
        """Reject a network of which a kernel ran that the trainer has not asked for."""
        if kernel is not None:
            detail = (
                f"expected {expected}; got {self._watcher.backward[kernel]} times {kernel}; only the trainer learns"
            )
            raise CandidateError(Reason.learns_by_itself, detail)

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


def _of_data(header: Header, payload: bytes, arrays: Arrays) -> Tensor | None:
    """Return the images of the data set that a job names, as the network gets them; None where it names none."""
    if "mean" not in header:
        return None
    mean, deviation = (torch.tensor(header[name])[:, None, None] for name in ("mean", "deviation"))
    return standardise(torch.from_numpy(arrays["images"][np.frombuffer(payload, np.int64)]), mean, deviation)


def _stepped(listed: list[nn.Parameter]) -> list[nn.Parameter]:
    """Return copies of parameters after the step that their gradients ask for, taken by an optimiser of their own."""
    apart = deepcopy([parameter.detach() for parameter in listed])  # together: some may share their memory
    copies = [nn.Parameter(each, parameter.requires_grad) for each, parameter in zip(apart, listed, strict=True)]
    for each, parameter in zip(copies, listed, strict=True):
        each.grad = None if parameter.grad is None else parameter.grad.clone()
    Adam(copies, _LEARNING_RATE).step()
    return copies


def _is_finite(tensor: Tensor) -> bool:
    """Return whether a tensor has neither NaN nor infinity, which its smallest and its largest value show."""
    return tensor.numel() == 0 or bool(torch.isfinite(torch.stack(torch.aminmax(tensor.detach()))).all())


def _form(tensor: Tensor) -> tuple[torch.Size, torch.dtype]:
    return tensor.shape, tensor.dtype


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
