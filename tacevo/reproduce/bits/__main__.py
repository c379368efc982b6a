"""Computes, in a process that has the variables of a level of numerics, all that is recorded of it.

It reads the recorded digests, a JSON object, from its standard input. Each line that it prints is a JSON list: what was
computed, and the digest of its bits. An operation that differs from the record has a third part: its kernels whose bits
may depend on the CPU.
"""

import itertools
import json
import sys
import warnings

import torch

from tacevo.reproduce.bits import networks, operations
from tacevo.reproduce.bits.expressions import expressions

#: Size of the images in pixels, and how many steps are taken.
_STEPS = {64: 1, 128: 1}


def main() -> None:
    """Print a line for each result, at once."""
    warnings.simplefilter("ignore")  # a candidate may call what torch would rather have called otherwise
    recorded = json.load(sys.stdin)
    _print(["kernels of ATen", torch.backends.cpu.get_cpu_capability()])
    for what, digest in itertools.chain(networks.trainings(), networks.convolutions(), networks.steps(_STEPS)):
        _print([what, digest[:16]])
    torch.set_deterministic_debug_mode("error")
    for expression in expressions():
        digest = operations.computed(expression)[:16]
        is_equal = recorded.get(expression) == digest
        _print([expression, digest, *([] if is_equal else [operations.not_portable(expression)])])


def _print(line: list[object]) -> None:
    print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
