"""What `test_portable.py` has computed in processes of their own, natively and under emulated CPUs.

Each job prints a JSON list a line: what was computed, and the digest of the bits it gave.
"""

import hashlib
import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fakes
import numpy as np
import torch
from gate_cases import contract
from numpy.typing import NDArray
from operations import expressions
from threadpoolctl import threadpool_info
from torch import Tensor, nn
from training_jobs import CONTRACT

from tacevo.archive import find_centroids
from tacevo.choices import LightScene, SensorTask
from tacevo.data.simulator import Simulated, draw
from tacevo.descriptors import describe
from tacevo.documents import archive_files
from tacevo.gate import probe
from tacevo.ledger import Ledger
from tacevo.randomness import stream
from tacevo.records import Contract, Json, Limits, Loss, Profile, Recipe, Training, to_json
from tacevo.sandbox.client import Finished, Frame
from tacevo.search import run_search
from tacevo.summary import summarise
from tacevo.training import trainer
from tacevo.training.evaluation import judge

LIBRARY = Path(__file__).parents[1] / "conf" / "library"
NETWORKS = Path(__file__).parent / "portable"

RECIPE = Recipe(
    epochs=1, batch_size=8, learning_rate=1e-3, optimiser="adam", limits=Limits(seconds=60, memory_mib=1_000)
)

#: What a summary reads of run.json.
RUN: Json = {
    "name": "run",
    "task": {"name": "force"},
    "config": {"seed": 3, "llm": {"model": "grammar-1"}, "numerics": {"kind": "portable"}},
    "data": {"fingerprint": "f" * 64, "counts": [384, 48, 48], "image_size": 32},
}

#: Shape of an element-wise operand.
_MANY = (20, 1000)


def surroundings() -> None:
    """Show what a host offers: the bits of functions that choose their code by the CPU, and the CPU that BLAS sees."""
    many = np.linspace(-20, 20, 100_001)
    _print("C library", _of_json([math.exp(value) for value in many.tolist()]))
    _print("NumPy", _digest([np.exp(many.astype(np.float32)).tobytes()]))
    _print("BLAS", str(sorted({str(pool["architecture"]) for pool in threadpool_info() if "architecture" in pool})))


def operations() -> None:
    """Compute every operation of `tests/operations.py`, forward and backward.

    A fork does it, and another one goes on where an emulator crashed; an expression at which a fresh fork crashes, too,
    is `crashed`.
    """
    torch.set_deterministic_debug_mode("error")
    waiting = list(expressions())
    while waiting:
        done = _printed_by_a_fork(waiting)
        if done == 0:
            _print(waiting[0], "crashed")
        waiting = waiting[max(done, 1) :]


def _printed_by_a_fork(waiting: Sequence[str]) -> int:
    """Compute expressions in a fork and print them; give how many it got done before it ended."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        with os.fdopen(writer, "w") as lines:
            for expression in waiting:
                print(json.dumps([expression, computed(expression)]), file=lines, flush=True)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as lines:
        done = [print(line, end="", flush=True) for line in lines]
    os.waitpid(pid, 0)
    return len(done)


def computed(expression: str) -> str:
    """Compute an expression, and the gradients of what it began with; give the digest of all of it.

    Returns:
        64 hex digits, or `refused` where torch has no deterministic form of it.
    """
    torch.manual_seed(0)
    inputs = operands()
    names = {"torch": torch, "nn": nn, "F": nn.functional, "math": math, **inputs}
    try:
        outputs = list(_tensors(eval(expression, names)))
        gradients = _gradients([output for output in outputs if output.requires_grad])
    except RuntimeError as error:
        if "deterministic" not in str(error):
            raise
        return "refused"
    return _digest([_bits(tensor) for tensor in [*outputs, *gradients]])


def operands() -> dict[str, Tensor]:
    """Give what the expressions name; those of float32 want gradients."""
    tensors = {name: torch.from_numpy(values.copy()) for name, values in _operands().items()}
    return {name: tensor.requires_grad_(tensor.is_floating_point()) for name, tensor in tensors.items()}


@cache
def _operands() -> dict[str, NDArray[Any]]:
    """Make the values, from whole numbers and correctly rounded operations alone."""
    draws = stream(0, "operands")
    even = np.arange(-150_000, 150_001) / 150_000

    def between(low: float, high: float, *shape: int) -> NDArray[np.float32]:
        return (low + (high - low) * draws.random(shape)).astype(np.float32)

    m = between(-0.5, 0.5, 5, 16, 16)
    return {
        **{"X": (8 * even).astype(np.float32), "L": even.astype(np.float32)},
        "P": (25.0005 + 24.9995 * even).astype(np.float32),
        **{"x": between(-6, 6, *_MANY), "y": between(-6, 6, *_MANY)},
        **{"p": between(1e-3, 6, *_MANY), "u": between(-0.999, 0.999, *_MANY)},
        "k": draws.integers(0, 100, _MANY),
        "w": between(-1, 1, 100),
        "i": between(-2, 2, 4, 8, 12, 12),
        "s": between(-2, 2, 4, 12, 8),
        "d": between(-2, 2, 2, 4, 6, 8, 8),
        "g": between(-1, 1, 4, 9, 9, 2),
        "m": m,
        # Symmetric and, by its diagonal, positive definite.
        "h": (m + m.transpose(0, 2, 1)) / 2 + 16 * np.eye(16, dtype=np.float32),
    }


def _gradients(outputs: Sequence[Tensor]) -> list[Tensor]:
    """Send fixed gradients back from the outputs; give those that arrive at the operands and the layers' weights."""
    draws = stream(0, "gradients")
    leaves = list(_leaves(outputs))
    seeds = [torch.from_numpy(draws.random(tuple(output.shape))).to(output.dtype) for output in outputs]
    if outputs:
        torch.autograd.backward(outputs, seeds)
    return [leaf.grad for leaf in leaves if leaf.grad is not None]


def _leaves(outputs: Sequence[Tensor]) -> Iterator[Tensor]:
    """Find the tensors that the outputs were computed from, in the order in which the graph names them."""
    waiting: list[Any] = [output.grad_fn for output in outputs]
    seen: set[int] = set()
    alive = []
    while waiting:
        node = waiting.pop(0)
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        alive.append(node)  # keeps its id from being given to another node
        if hasattr(node, "variable"):
            yield node.variable
        waiting += [following for following, _ in node.next_functions]


def _tensors(value: Any) -> Iterator[Tensor]:
    """Walk the tensors of a result, which may be nested."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _tensors(item)
    elif value is not None:
        yield torch.tensor(value)


def _bits(tensor: Tensor) -> bytes:
    """Give a tensor's bytes; every NaN alike, since which one it is follows no rule."""
    plain = tensor.detach().clone().resolve_conj()
    if plain.is_complex():
        plain = torch.view_as_real(plain)
    if plain.dtype is torch.bfloat16:  # NumPy has none; float32 holds its numbers exactly
        plain = plain.float()
    values: NDArray[Any] = plain.numpy()
    if values.dtype.kind == "f":
        values[np.isnan(values)] = np.nan
    return values.tobytes()


def _digest(parts: Sequence[bytes]) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()


def networks() -> None:
    """Probe and train the three baselines and the networks of `tests/portable`; then compute what else a run holds."""
    for name, source, task in candidates():
        profile = _probed(source, task)
        frames = _trained(source, task)
        _print(f"{name}: probe", _of_json(to_json(profile)))
        _print(f"{name}: descriptors", _of_json(to_json(describe(profile))))
        _print(f"{name}: training", _digest([json.dumps(frame.header).encode() + frame.payload for frame in frames]))
        verdict = judge(Finished(frames), task, RECIPE.epochs, _targets(task)[16:])
        if not isinstance(verdict, Training):
            raise ValueError(f"{name} should train; got {verdict}")
        _print(f"{name}: losses", _of_json(to_json(verdict)))
    for simulated in SensorTask:
        _print(f"images and labels of {simulated}", _digest(list(_simulated(simulated))))
    shape = {"niches": 25, "dimensions": 2, "samples": 2_000, "seed": 0}
    _print("centroids", _of_json(find_centroids(**shape)))
    _search()


def candidates() -> Iterator[tuple[str, str, Contract]]:
    """Give what is trained: name, source and contract."""
    for task in ("force", "grating", "hardness"):
        source = (LIBRARY / task / "baseline.py").read_text(encoding="utf-8")
        yield f"baseline of {task}", source, _contract(source, "grating" if task == "grating" else "force")
    for path in sorted(NETWORKS.glob("*.py.txt")):
        yield path.name.partition(".")[0], path.read_text(encoding="utf-8"), replace(CONTRACT, image_size=32, outputs=3)


def _contract(source: str, kind: str) -> Contract:
    """Give a baseline's contract, with its own class name."""
    (name,) = re.findall(r"^class (\w+)", source, re.MULTILINE)
    (argument,) = re.findall(r"in_channels=3, (\w+)=", source)
    return replace(contract(kind), class_name=name, output_argument=argument)


def _probed(source: str, task: Contract) -> Profile:
    frames: list[Json] = []
    limits = {"parameters": 50_000_000, "flops": 10**10, "modules": 2_000}
    header = {"source": source, "contract": to_json(task), "limits": limits}
    probe.run(header, b"", {}, lambda frame, _: frames.append(frame))
    return Profile.from_json(frames[0]["profile"])


def _trained(source: str, task: Contract) -> tuple[Frame, ...]:
    """Train for one epoch of two steps at 32 pixels."""
    frames: list[Frame] = []
    images = stream(0, "images").integers(0, 256, (24, 3, 32, 32), dtype=np.uint8)
    rows = np.arange(24)
    header = {
        **{"source": source, "contract": to_json(task), "recipe": to_json(RECIPE), "seed": 0},
        **{"mean": [127.5] * 3, "deviation": [74.0] * 3, "train": 16, "validation": 8},
    }
    payload = rows.tobytes() + _targets(task)[:16].tobytes()
    trainer.run(header, payload, {"images": images}, lambda head, data: frames.append(Frame(head, data)))
    return tuple(frames)


def _targets(task: Contract) -> NDArray[Any]:
    draws = stream(0, "targets")
    if task.loss is Loss.mse:
        return draws.random((24, task.outputs)).astype(np.float32)
    return draws.integers(0, task.outputs, 24)


def _simulated(task: SensorTask) -> Iterator[bytes]:
    """Give the labels of a simulated data set and two of its images."""
    source = Simulated(
        task=task,
        images=20,
        image_size=32,
        seed=0,
        sensor_seed=1,
        light=LightScene.side,
        spacings_mm=(0.5, 1.0, 2.0),
    )
    yield source.catalogue().labels.tobytes()
    yield from (draw(source, index).tobytes() for index in (0, 19))


def _search() -> None:
    """Search with fake effects: its ledger, its archives and the tables of its summary."""
    plan = fakes.plan(generations=2)
    recorder = fakes.Recorder()
    with Ledger(None) as ledger:
        state = run_search(plan, fakes.tools(), ledger, recorder)
        _print("ledger", ledger.digest)
    elites = [elite.name for elite in state.networks.archive.elites.values()]
    _print("archives", _of_json(archive_files(plan, state)))
    _print("tables", _digest([summarise(RUN, recorder.lines, elites, {}).encode()]))


def _of_json(value: Json) -> str:
    return _digest([json.dumps(value).encode()])


def _print(what: str, digest: str) -> None:
    print(json.dumps([what, digest]), flush=True)
