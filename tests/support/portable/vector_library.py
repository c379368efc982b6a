"""Finds the functions whose bits MKL's vector library chooses by the CPU: `make bits`.

ATen takes some functions from that library, which has other code for other CPUs, whatever MKL_CBWR says. Which code it
takes can be set by MKL_VML_DEBUG_CPU_TYPE, so that one CPU shows what others would compute. Each function that a
candidate may name is computed on many values of all magnitudes, forward and backward, in float32 and float64.
"""

import hashlib
import inspect
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

#: The variable, and the codes that it names; a CPU without their instructions cannot run the later ones.
CODE, CODES = "MKL_VML_DEBUG_CPU_TYPE", ("0", "1", "3", "5", "9")
#: Of MKL's other libraries; with the code set, no result may follow it.
INSTRUCTIONS = ("SSE4_2", "AVX2", "AVX512")
_VALUES = 1 << 18


def main() -> int:
    """Print what follows from the code; return 1 where something does although the code is set as a training has it."""
    from tacevo.choices import Numerics
    from tacevo.training.numerics import environment

    settings = environment(Numerics.portable)
    chosen = _digests(settings)
    if chosen is None:
        raise SystemExit("expected digests of the functions; got none: the child process failed")
    assert settings[CODE] in CODES
    others = {code: digests for code in CODES if (digests := _digests({**settings, CODE: code})) is not None}
    by_code = [name for name in chosen if any(digests.get(name) != chosen[name] for digests in others.values())]
    print(f"{len(chosen)} results; codes {', '.join(others)} run here. {len(by_code)} follow from the code:")
    print("\n".join(f"    {name}" for name in by_code))
    free = {name: value for name, value in settings.items() if name != CODE}
    left = {
        instructions: [name for name, value in chosen.items() if digests.get(name) != value]
        for instructions in INSTRUCTIONS
        if (digests := _digests({**settings, "MKL_ENABLE_INSTRUCTIONS": instructions})) is not None
    }
    unset = _digests(free)
    print(f"with {CODE}={settings[CODE]}, these follow from MKL_ENABLE_INSTRUCTIONS: {left}")
    is_own = "the same" if unset == chosen else "another"
    print(f"without {CODE} this CPU takes {is_own} code")
    return 0 if by_code and not any(left.values()) else 1


def _digests(settings: Mapping[str, str]) -> dict[str, str] | None:
    """Compute everything in a process with these settings; None where it failed, as without the instructions."""
    command = [sys.executable, __file__, "--digests"]
    done = subprocess.run(command, env={**os.environ, **settings}, capture_output=True, check=False)
    return None if done.returncode else dict(json.loads(done.stdout))


def digests() -> dict[str, str]:
    """Hash each function's results, and its gradient where it has one."""
    import torch

    found: dict[str, str] = {}
    for kind in (torch.float32, torch.float64):
        inputs = [*_inputs(kind)]
        for name, function in _functions():
            results = []
            for values in inputs:
                try:
                    results += _computed(function, values)
                except (RuntimeError, TypeError, ValueError, IndexError, AttributeError):
                    continue  # not of such values
            if results:
                found[f"{name} {str(kind).removeprefix('torch.')}"] = hashlib.sha256(b"".join(results)).hexdigest()[:12]
    return found


def _functions() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Return the functions of one tensor, or of two, that a candidate may name; none that makes a tensor."""
    import torch

    from tacevo.gate.policy.allowed import is_allowed

    makes = {"rand", "randn", "randint", "randperm", "empty", "arange", "linspace", "logspace", "eye"}
    for module in (torch, torch.special, torch.linalg, torch.nn.functional):
        for name in sorted(dir(module)):
            function = getattr(module, name)
            is_left_out = name.endswith(("_like", "_")) or name in makes
            if is_allowed(module.__name__, name) and not is_left_out and not inspect.isclass(function):
                yield f"{module.__name__}.{name}", function
    for exponent in (0.5, -0.5, 0.25, 1.5, 3, 3.3):
        yield f"power {exponent}", lambda values, exponent=exponent: values**exponent


def _inputs(kind: Any) -> Iterator[Any]:
    """Return values of all magnitudes, between -1 and 1, and between 0.001 and 50; and some matrices."""
    import numpy as np
    import torch

    draws = np.random.default_rng(1)
    bits, floats = ("u4", "f4") if kind is torch.float32 else ("u8", "f8")
    every = draws.integers(0, 2 ** (8 * int(bits[1])), _VALUES, dtype=bits).view(floats)
    yield torch.from_numpy(every[np.isfinite(every)])
    yield torch.from_numpy(draws.uniform(-1, 1, _VALUES)).to(kind)
    yield torch.from_numpy(draws.uniform(0.001, 50, _VALUES)).to(kind)
    matrices = torch.from_numpy(draws.standard_normal((8, 24, 24))).to(kind)
    yield matrices @ matrices.mT + 24 * torch.eye(24, dtype=kind)


def _computed(function: Callable[..., Any], values: Any) -> list[bytes]:
    import torch

    results = []
    for others in ([], [values.flip(0)]):
        torch.manual_seed(0)  # for those that draw
        asked = values.clone().requires_grad_()
        try:
            result = function(asked, *others)
        except (RuntimeError, TypeError, ValueError, IndexError, AttributeError):
            continue
        parts = [
            part for part in (result if isinstance(result, tuple) else (result,)) if isinstance(part, torch.Tensor)
        ]
        results += [_bytes(part) for part in parts]
        for part in itertools.islice((part for part in parts if part.requires_grad and part.is_floating_point()), 1):
            torch.autograd.backward(part.sum())
            results += [] if asked.grad is None else [_bytes(asked.grad)]
    return results


def _bytes(tensor: Any) -> bytes:
    """Return a tensor's bytes, with one NaN for all: their bits follow the code, and nothing follows from them."""
    import torch

    values = torch.view_as_real(tensor) if tensor.is_complex() else tensor
    plain = (
        torch.nan_to_num(values.detach(), nan=0.125, posinf=None, neginf=None) if values.is_floating_point() else values
    )
    return bytes(plain.contiguous().numpy().tobytes())


if __name__ == "__main__":
    if "--digests" in sys.argv:
        import torch

        torch.set_num_threads(1)
        from tacevo.sandbox.functions import portable_functions

        torch.set_deterministic_debug_mode("error")  # also fills memory that nothing was written to
        with portable_functions():  # as in a training
            json.dump(digests(), sys.stdout)
    else:
        sys.exit(main())
