"""A training's step, recorded once on a GPU and replayed (child side): the processor starts one graph a step.

Run eagerly, a step is some hundred kernels that Python starts one by one, and the device waits for it. A CUDA graph
holds the kernels of one step: take a batch, standardise, forward, loss, backward, Adam, write the loss into a buffer.
The losses of an epoch are read once, in its end.

A replay repeats kernels, in the memory that they were recorded with, and runs no Python. So only a network is captured
whose step is the same each time: it waits for nothing that the device computed, as a branch by data does; it draws no
number on the processor; it puts no other tensor in the place of one that it keeps (one that is changed in place stays);
and no number, text, flag or size of a list of its own changes, as a count of calls does. A second network of the same
source tries that before the first step. Any other network trains eagerly. That follows from its source, and from the
memory that the recipe gives it, never from a clock.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from tacevo.records import Reason
from tacevo.sandbox.guards import CandidateError
from tacevo.sandbox.module_parts import bits, equal
from tacevo.sandbox.outside import kept, plain_values

#: Takes a step on the batch of these places among the training images, int64 of shape (n,), and returns its loss.
Step = Callable[[Tensor], Tensor]
#: Records the kernels of what it is given, and returns what runs them again. Nothing is computed by it.
Capture = Callable[[Callable[[], None]], Callable[[], None]]

#: Steps that the second network takes after its first: libraries are started, and what changes shows itself.
_TRIED = 2


def capture(step: Callable[[], None]) -> Callable[[], None]:
    """Record a step as a CUDA graph.

    Raises:
        RuntimeError: it does what a graph cannot hold.
    """
    graph = torch.cuda.CUDAGraph()
    torch.cuda.synchronize()
    # Where recording fails, torch does not leave the stream that it recorded in.
    with torch.cuda.stream(torch.cuda.current_stream()), torch.cuda.graph(graph):
        step()
    return graph.replay


def repeats_itself(network: nn.Module, step: Step, batch: NDArray[np.int64], device: torch.device) -> bool:
    """Return whether a network's steps are the same each time, as far as a few of them show; they train it.

    Raises:
        RuntimeError: on a GPU, a step waited for the device.
    """
    positions = torch.from_numpy(batch).to(device)
    with _beside(device):
        step(positions)  # its first step may make what it keeps from then on
        plain, drawn = plain_values(network), torch.get_rng_state()
        tensors, sizes = kept(network)
        here = [bits(tensor).clone() for tensor in _on_another(tensors, device)]
        with _refusing_to_wait(device):
            for _ in range(_TRIED):
                step(positions)
        after, sizes_after = kept(network)
    is_drawn = device.type != "cpu" and not torch.equal(torch.get_rng_state(), drawn)
    return (
        plain_values(network) == plain
        and not is_drawn
        and {*map(id, after)} == {*map(id, tensors)}
        and sizes_after == sizes
        and all(map(equal, map(bits, _on_another(after, device)), here))
    )


def _on_another(tensors: Sequence[Tensor], device: torch.device) -> list[Tensor]:
    """Return the tensors on another device than the network's: what they hold is recorded once for all."""
    return [tensor for tensor in tensors if tensor.device.type != device.type]


@contextmanager
def _beside(device: torch.device) -> Iterator[None]:
    """Compute on a GPU in a stream beside the usual one, as recording will, and wait for it in the end."""
    if device.type == "cpu":
        yield
        return
    with torch.cuda.stream(torch.cuda.Stream()):  # type: ignore[no-untyped-call]
        yield
    torch.cuda.synchronize()


@contextmanager
def _refusing_to_wait(device: torch.device) -> Iterator[None]:
    """Have an error where the processor waits for a GPU, before any recording begins, which it would leave broken."""
    if device.type == "cpu":
        yield
        return
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CapturedSteps:
    """The recorded step of a training, and the memory that it reads and writes."""

    #: The batches of an epoch, int64 of shape (steps, n); each step takes the next one.
    order: Tensor
    #: Steps so far, int64 of shape (1,).
    taken: Tensor
    #: Float32, shape (steps,).
    losses: Tensor
    replay: Callable[[], None]

    @classmethod
    def of(cls, first: Sequence[NDArray[np.int64]], device: torch.device, step: Step, capture: Capture) -> Self:
        """Record a step, for epochs of as many batches as the first one's.

        Raises:
            RuntimeError: it cannot be recorded.
        """
        order = torch.from_numpy(np.stack(first)).to(device)
        taken = torch.zeros(1, dtype=torch.int64, device=device)
        losses = torch.zeros(len(first), device=device)

        def take() -> None:
            loss = step(order.index_select(0, taken).reshape(-1))
            losses.index_copy_(0, taken, loss.detach().reshape(1))
            taken.add_(1)

        return cls(order=order, taken=taken, losses=losses, replay=capture(take))

    def epoch(self, batches: Sequence[NDArray[np.int64]]) -> list[float]:
        """Take the steps of an epoch; return their losses.

        Raises:
            CandidateError: one is not finite.
        """
        self.order.copy_(torch.from_numpy(np.stack(batches)))
        self.taken.zero_()
        for _ in batches:
            self.replay()
        losses: list[float] = self.losses.tolist()
        for number, loss in enumerate(losses, start=1):
            if not math.isfinite(loss):
                detail = f"expected a finite training loss; got {loss} in step {number} of an epoch"
                raise CandidateError(Reason.not_finite, detail)
        return losses
