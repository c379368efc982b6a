"""What a process that was forked pays until a GPU computes: driver, cuBLAS, cuDNN, a recorded step.

    python -m benchmarks.gpu_start [cpu]

A process that has imported torch forks one for each measurement, as the zygote does. First without, then with CUDA's
libraries mapped before the fork (`tacevo.training.cuda_libraries`). Of each stage the median of some processes.
"""

import os
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence

import torch

from tacevo.text import table
from tacevo.training.captured import capture
from tacevo.training.cuda_libraries import map_libraries

ROUNDS = 5


def stages(device: torch.device) -> Mapping[str, Callable[[], object]]:
    """Return what a first training does for the first time, in this order."""
    image = [torch.zeros(0)]  # the driver is not asked before the first stage

    def convolve() -> None:
        layer = torch.nn.Conv2d(3, 8, 3).to(device)
        layer(image[0]).sum().backward()

    def start() -> None:
        image[0] = torch.ones(8, 3, 32, 32, device=device)

    def product() -> float:
        flat = image[0].reshape(8, -1)
        return float((flat @ flat.T).sum())

    def step() -> None:
        image[0].mul_(1.0)

    def record() -> None:
        capture(step)()

    named: dict[str, Callable[[], object]] = {"driver": start, "product": product, "convolution": convolve}
    if device.type == "cuda":
        named["recorded step"] = record
    return named


def one_start(device: torch.device) -> list[float]:
    """Fork, take the stages in the new process, and return the seconds: until the fork runs, and of each stage."""
    reading, writing = os.pipe()
    began = time.perf_counter()
    pid = os.fork()
    if pid == 0:
        try:
            seconds = [time.perf_counter() - began]
            for stage in stages(device).values():
                before = time.perf_counter()
                stage()
                if device.type == "cuda":
                    torch.cuda.synchronize()
                seconds.append(time.perf_counter() - before)
            os.write(writing, " ".join(map(repr, seconds)).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        said = pipe.read()
    os.waitpid(pid, 0)
    return [float(word) for word in said.split()]


def measured(device: torch.device, rounds: int = ROUNDS) -> str:
    """Return a table: a row without and one with mapped libraries.

    Raises:
        RuntimeError: a process ended before it had computed.
    """
    names = ["fork", *stages(device)]
    rows = []
    for is_mapped in (False, True):
        label = f"with {len(map_libraries())} libraries mapped" if is_mapped else "as torch is imported"
        starts = [one_start(device) for _ in range(rounds)]
        if any(len(start) != len(names) for start in starts):
            raise RuntimeError(f"expected seconds of {', '.join(names)}; got {starts}")
        medians = [statistics.median(each) for each in zip(*starts, strict=True)]
        rows.append([label, *(f"{value:.3f}" for value in medians), f"{sum(medians):.3f}"])
    return table(["s of a process", *names, "in all"], rows)


def main(arguments: Sequence[str]) -> int:
    """Measure; on a GPU nothing may ask for one before, so an absent one shows in the first process."""
    print(measured(torch.device(arguments[0] if arguments else "cuda")))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
