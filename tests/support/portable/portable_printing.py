"""How the jobs of `test_portable.py` tell what they computed: a JSON list a line, a name and the digest of its bits."""

import hashlib
import json
import os
from collections.abc import Sequence

from tacevo.records import Json
from tacevo.sandbox import caches


def show(what: str, digest: str) -> None:
    """Print a line at once, so that it is there even if the emulator crashes at the next."""
    print(json.dumps([what, digest]), flush=True)


def digest(parts: Sequence[bytes]) -> str:
    """Hash bytes: 64 hex digits of SHA-256."""
    return hashlib.sha256(b"".join(parts)).hexdigest()


def digest_of_json(value: Json) -> str:
    """Hash plain JSON values."""
    return digest([json.dumps(value).encode()])


def elsewhere() -> None:
    """Compute the convolutions on a CPU whose caches have other sizes, `OTHER`, as far as oneDNN can tell."""
    import torch  # noqa: F401  # before the numerics' own sizes are set, which importing the trainings does

    caches.pin([int(size) for size in os.environ["OTHER"].split(",")])
    from portable_trainings import convolutions

    convolutions()
