"""What confinement costs: at a candidate's start, and in its training."""

import contextlib
import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from benchmarks import plain_training as plain
from benchmarks.timing import Figure, descendants_seconds, medians, report
from tacevo.choices import Confinement, Numerics
from tacevo.errors import ConfigError
from tacevo.records import Json, Limits, Recipe, to_json
from tacevo.runs.answers import task_without_data
from tacevo.runs.wiring import ENTRIES
from tacevo.sandbox.client import Finished, Sandbox
from tacevo.training.numerics import check_machine, environment

JOBS = 10

#: Size of the images in pixels: by how many epochs a training is longer than the one that it is compared with.
EPOCHS = {32: 8, 64: 3, 128: 1}

#: What the bare loop is called.
BARE = f"plain torch, {Numerics.fast}"

_LIMITS = Limits(seconds=600, memory_mib=2048)  # of wall time, and the machine may be busy


class Seconds(NamedTuple):
    """What a training takes of a processor."""

    #: Beside its epochs.
    start: float
    epoch: float


def walls(*, rounds: int = 9) -> Figure:
    """Start candidates that do next to nothing behind the kernel's walls; the peer leaves the walls out."""
    with tempfile.TemporaryDirectory() as folder:
        sandboxes = {
            "behind the walls": _sandbox(Path(folder), Confinement.kernel),
            "without them": _sandbox(Path(folder), Confinement.process),
        }
        with sandboxes["behind the walls"], sandboxes["without them"]:
            rates = medians({name: partial(_starts, sandbox) for name, sandbox in sandboxes.items()}, rounds=rounds)
    return report("starting and ending a candidate", rates, unit="candidates", count=JOBS)


def training(*, epochs: Mapping[int, int] = EPOCHS, rounds: int = 3) -> Iterator[Figure]:
    """Train a baseline, confined, with each numerics that this CPU can, on images of 32, 64 and 128 pixels.

    The peer is the best bare loop in an ordinary process, with any instruction set. A confined training is a new
    process, which compiles its kernels, touches its memory and tries two memory layouts, while the peer's process stays
    warm. So the rates are of what a longer training takes beside one of one epoch, and the start is a figure of its
    own. All is processor time, of one thread each, so a busy machine matters little.
    """
    return itertools.chain.from_iterable(_training(size, count, rounds) for size, count in epochs.items())


def _training(size: int, epochs: int, rounds: int) -> Iterator[Figure]:
    seconds = _seconds_of_training(size, epochs=epochs, rounds=rounds)
    for name in [name for name in seconds if name != BARE]:
        pair = {one: seconds[one].epoch for one in (name, BARE)}
        yield report(f"training at {size} px", pair, unit="images", count=plain.TRAINED + plain.PREDICTED)
        title = f"start and end of a training at {size} px"
        yield Figure(title=title, name=name, value=seconds[name].start, unit="s")


def _seconds_of_training(size: int, *, epochs: int, rounds: int) -> dict[str, Seconds]:
    """Measure a baseline's trainings, confined with each numerics and in the bare loop, by name.

    Args:
        size: of the images, in pixels.
        epochs: by how many a training is longer than the one of a single epoch that it is compared with.
        rounds: how often each is measured.
    """
    trained, predicted = plain.TRAINED, plain.PREDICTED
    _, task = task_without_data("force", size)
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        place = Path(folder)
        source = place / "baseline.py"
        source.write_text(task.baseline, encoding="utf-8")
        header: Json = {"source": task.baseline, "contract": to_json(task.contract)}
        work: dict[tuple[str, int], Callable[[], object]] = {}
        counts = (1, 1 + epochs)
        for numerics in computable():
            name = f"confined, {numerics}"
            sandbox = stack.enter_context(_sandbox(place, Confinement.kernel, size, numerics, trained + predicted))
            work |= {(name, count): partial(_train, sandbox, header, count, trained, predicted) for count in counts}
        path = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path)}
        order = environment(Numerics.fast) | path  # one thread, memory that is kept, any instruction set
        command = [sys.executable, "-m", plain.__name__, str(source), *map(str, (size, trained, predicted))]
        peer = subprocess.Popen(command, env=order, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(peer.wait)
        assert peer.stdin is not None
        assert peer.stdout is not None
        stack.callback(peer.stdin.close)
        peer.stdout.readline()
        work |= {(BARE, count): partial(_ask, peer.stdin, peer.stdout, count) for count in counts}
        _ask(peer.stdin, peer.stdout, 1)  # it is warm from here on
        seconds = medians(work, rounds=rounds, clock=descendants_seconds)
    told = {}
    for name in dict.fromkeys(name for name, _ in work):
        one, long = (seconds[name, count] for count in counts)
        epoch = (long - one) / epochs
        told[name] = Seconds(start=one - epoch, epoch=epoch)
    return told


def computable() -> list[Numerics]:
    """List the numerics that this machine can compute with."""
    able = []
    for numerics in Numerics:
        with contextlib.suppress(ConfigError):
            check_machine(numerics)
            able.append(numerics)
    return able


def _ask(requests: IO[str], answers: IO[str], epochs: int) -> None:
    """Have the peer train."""
    print(epochs, file=requests, flush=True)
    answers.readline()


def _sandbox(
    folder: Path,
    strongest: Confinement,
    size: int = 32,
    numerics: Numerics = Numerics.portable,
    count: int = 1,
) -> Sandbox:
    """Open a sandbox with random images, and have its zygote start."""
    images = folder / "images.npy"
    rng = np.random.default_rng(0)
    np.save(images, rng.integers(0, 256, (count, 3, size, size), dtype=np.uint8))
    opened = Sandbox(entries=ENTRIES, environment=environment(numerics), arrays={"images": images}, strongest=strongest)
    _starts(opened, jobs=1)
    return opened


def _starts(sandbox: Sandbox, jobs: int = JOBS) -> None:
    """Run jobs that fail at their first line."""
    for _ in range(jobs):
        sandbox.run("probe", {}, b"", _LIMITS)


def probe(sandbox: Sandbox, header: Json) -> None:
    """Have the gate's probe measure a candidate; the header holds its source and contract."""
    assert isinstance(header, dict)
    sizes = {"parameters": 10**9, "flops": 10**12, "modules": 10_000}
    answer = sandbox.run("probe", {**header, "limits": sizes}, b"", _LIMITS)
    assert isinstance(answer, Finished), answer


def _train(sandbox: Sandbox, header: Json, epochs: int, trained: int, predicted: int) -> None:
    """Have a confined candidate train on the random images."""
    assert isinstance(header, dict)
    recipe = Recipe(
        epochs=epochs,
        batch_size=plain.BATCH,
        learning_rate=plain.LEARNING_RATE,
        optimiser="adam",
        limits=_LIMITS,
    )
    setting: dict[str, Json] = {
        "recipe": to_json(recipe),
        "seed": 0,
        "mean": [plain.MEAN] * 3,
        "deviation": [plain.DEVIATION] * 3,
        "train": trained,
        "validation": predicted,
    }
    targets = np.random.default_rng(1).random((trained, 3), dtype=np.float32)
    payload = np.arange(trained + predicted).tobytes() + targets.tobytes()
    answer = sandbox.run("train", {**header, **setting}, payload, _LIMITS)
    assert isinstance(answer, Finished), answer
