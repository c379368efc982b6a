"""The child's side of a job: from source text to a network, from stored images to its input, from an error to a reason.

Only entries import this module. It needs torch, and the code that it runs may be hostile.
"""

import hashlib
import math
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import torch
from torch import nn

from tacevo.records import Contract, Json, Reason
from tacevo.sandbox import caches
from tacevo.sandbox.child import Send
from tacevo.sandbox.guards import NAME, TEXTS_BUILTINS, CandidateError, check_shared
from tacevo.sandbox.module_parts import leaves, state
from tacevo.sandbox.protocol import describe

if sizes := os.environ.get(caches.VARIABLE):
    caches.pin([int(size) for size in sizes.split(",")])

torch.zeros(1).half()  # at first use torch reads the CPU's features from a file, which no candidate could

#: The words in errors of failed allocations: on a CPU, of CUDA's driver, of cuBLAS and cuDNN.
_FAILED_ALLOCATIONS = (
    "can't allocate memory",
    "CUDA error: out of memory",
    "CUBLAS_STATUS_ALLOC_FAILED",
    "CUDNN_STATUS_ALLOC_FAILED",
)

#: The file from which a generator gets a seed; a candidate cannot open it.
_ENTROPY = "/dev/urandom"


def call_plainly(*functions: Any) -> None:
    """Have torch call what `torch._disable_dynamo` made directly, where it would first import its compiler."""
    for function in functions:
        plain = function.__wrapped__
        plain.__dynamo_disable = plain  # torch looks this up, and imports the compiler to make it where it is missing


call_plainly(torch.optim.Optimizer.add_param_group, torch.optim.Optimizer.zero_grad)
_ADAM_STEP: Any = vars(torch.optim.Adam.step)["__wrapped__"]


class Adam(torch.optim.Adam):
    """Adam, fused, with a step that needs no compiler to switch gradients off, and does not ask for a GPU."""

    def __init__(self, parameters: Iterable[nn.Parameter], learning_rate: float, *, is_captured: bool = False) -> None:
        # The other forms take their square root from a library whose last bit depends on the CPU.
        super().__init__(parameters, learning_rate, fused=True, capturable=is_captured)

    @torch.no_grad()
    def step(self) -> None:  # type: ignore[override]
        """Take one step."""
        _ADAM_STEP(self)

    def _accelerator_graph_capture_health_check(self) -> None:
        """Look for no GPU: a process that has asked the driver once cannot be forked into one that uses it."""

    _cuda_graph_capture_health_check = _accelerator_graph_capture_health_check  # its name before torch 2.9


# At its first step torch looks for optional modules, which no candidate's process could.
_parameter = nn.Parameter(torch.zeros(1))
_parameter.grad = torch.zeros(1)
Adam([_parameter], 0.0).step()


def build(source: str, contract: Contract, seed: int) -> nn.Module:
    """Run a candidate's source and construct its network.

    The text sees `torch`, `nn`, `F` and `math` without importing them, since answers often leave the imports
    out, and the built-in functions of `tacevo.sandbox.guards`, so that no computed name reaches what the gate's policy
    refuses. Torch's generator is seeded first, so the initial weights follow from the arguments alone.

    Raises:
        CandidateError: it reaches for a refused name, or changed a class of torch.
        TypeError: the source does not define such a class, or it or what it makes is not an `nn.Module`.
        Exception: what the source raises.
    """
    module = ModuleType(NAME)
    sys.modules[NAME] = module  # where dataclasses and type hints look their names up
    # As a dictionary of its own, and not as globals, which a text could delete.
    module.__dict__["__builtins__"] = dict(TEXTS_BUILTINS)
    module.__dict__.update(torch=torch, nn=nn, F=nn.functional, math=math)
    torch.set_deterministic_debug_mode("error")  # as use_deterministic_algorithms(True), without importing a compiler
    torch.manual_seed(seed)
    exec(compile(source, f"<{NAME}>", "exec"), module.__dict__)
    made = module.__dict__.get(contract.class_name)
    if not (isinstance(made, type) and issubclass(made, nn.Module)):
        raise TypeError(f"expected a class {contract.class_name} that extends nn.Module; got {type(made).__name__}")
    network: nn.Module = contract.construct(made)
    check_shared()
    if not issubclass(type(network), nn.Module):
        raise TypeError(f"expected {contract.class_name}() to be an nn.Module; got {type(network).__name__}")
    return network


def standardise(images: torch.Tensor, mean: torch.Tensor, deviation: torch.Tensor) -> torch.Tensor:
    """Turn stored images, uint8, into network input, float32: (images - mean) / deviation, shape (n, C, S, S).

    Mean and deviation, which is positive, are float32 of shape (C, 1, 1), in units of the stored values.
    """
    return images.to(torch.float32).sub_(mean).div_(deviation)


def fault(output: object, shape: tuple[int, ...]) -> str | None:
    """Return why an output is not a plain float32 tensor of the shape; None where it is one.

    A subclass of Tensor is refused, because its own methods could answer every later question.
    """
    if type(output) is not torch.Tensor:
        return f"expected a torch.Tensor; got {type(output).__name__}"
    if output.dtype is not torch.float32:
        return f"expected float32; got {output.dtype}"
    if tuple(output.shape) != shape:
        return f"expected shape {shape}; got {tuple(output.shape)}"
    return None


@contextmanager
def blaming(reason: Reason) -> Iterator[None]:
    """Turn what the candidate raises into a failure for this reason, or for `out_of_memory` where that is the cause.

    Raises:
        CandidateError: the body raised an exception, or this very error.
    """
    try:
        yield
    except CandidateError:
        raise
    except Exception as error:
        detail = describe(error)
        if _ENTROPY in detail:
            detail = "expected a seed that follows the trainer's; got one of the machine; use torch's own generator"
            raise CandidateError(Reason.fixed_seed, detail) from error
        is_refused_memory = isinstance(error, MemoryError | torch.OutOfMemoryError) or (
            isinstance(error, RuntimeError) and any(words in str(error) for words in _FAILED_ALLOCATIONS)
        )
        raise CandidateError(Reason.out_of_memory if is_refused_memory else reason, detail) from error


def check_leaves(output: torch.Tensor, listed: list[nn.Parameter]) -> None:
    """Check that what a network returned learns by the listed parameters, which are its own, only.

    Raises:
        ValueError: the output does not require a gradient.
        CandidateError: a tensor in the output's graph requires a gradient and is not a parameter of the network.
    """
    known = {id(parameter) for parameter in listed}
    hidden = [leaf for leaf in leaves(output) if id(leaf) not in known]
    if hidden:
        detail = (
            f"expected only parameters of the network to learn; got {len(hidden)} other tensors, one of shape "
            f"{tuple(hidden[0].shape)}; make them in the constructor, in attributes, nn.ModuleList or nn.ParameterList"
        )
        raise CandidateError(Reason.hidden_parameters, detail)


def digest(model: nn.Module) -> str:
    """Hash every weight and persistent buffer with its name, type and shape: 64 hex digits of SHA-256."""
    total = hashlib.sha256()
    for name, value in sorted(state(model).items()):
        total.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        total.update(torch.Tensor.detach(value).cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return total.hexdigest()


def send_weights(weights: Mapping[str, torch.Tensor], send: Send) -> None:
    """Send weights and buffers as plain bytes: `{"weights": [[name, type, shape], ...]}`, types as torch names them."""
    values = {name: torch.Tensor.detach(value).cpu().contiguous() for name, value in weights.items()}
    described: Json = [[name, str(value.dtype), list(value.shape)] for name, value in values.items()]
    data = b"".join(value.reshape(-1).view(torch.uint8).numpy().tobytes() for value in values.values())
    send({"weights": described}, data)
