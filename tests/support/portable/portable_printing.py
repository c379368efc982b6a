"""How the jobs of `test_portable.py` tell what they computed: a JSON list a line, a name and the digest of its bits."""

import hashlib
import itertools
import json
import os

from tacevo.records import Json
from tacevo.sandbox import caches


def show(what: str, digest: str) -> None:
    """Print a line at once, so that it is there even if the emulator crashes at the next."""
    print(json.dumps([what, digest]), flush=True)


def digest_of_json(value: Json) -> str:
    """Hash plain JSON values."""
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def elsewhere() -> None:
    """Compute the convolutions on a CPU whose caches have other sizes, `OTHER`, as far as oneDNN can tell."""
    import torch  # noqa: F401  # before the numerics' own sizes are set, which importing the trainings does

    caches.pin([int(size) for size in os.environ["OTHER"].split(",")])
    convolutions()


def convolutions() -> None:
    """Show the convolutions that depend on the sizes of the caches."""
    from tacevo.reproduce.bits import networks

    for what, bits in networks.convolutions():
        show(what, bits)


def steps() -> None:
    """Show further steps, which were also computed on an Intel Xeon with AVX-512."""
    from tacevo.reproduce.bits import networks

    for what, bits in networks.steps({32: 63, 64: 27, 128: 11}):
        show(what, bits)


def operations() -> None:
    """Show all expressions, but for the first `SKIP` of them."""
    import torch

    from tacevo.reproduce.bits.expressions import expressions
    from tacevo.reproduce.bits.operations import computed

    torch.set_deterministic_debug_mode("error")
    for expression in itertools.islice(expressions(), int(os.environ.get("SKIP", "0")), None):
        show(expression, computed(expression))
