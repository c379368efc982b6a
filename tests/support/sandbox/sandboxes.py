"""A sandbox for attacks, without the walls that need a special kernel, and how to ask it."""

from pathlib import Path
from typing import Any

import attacks
import numpy as np
import wall_attacks

from tacevo.choices import Confinement, Numerics
from tacevo.records import Limits
from tacevo.sandbox.client import Finished, Sandbox
from tacevo.training.numerics import environment

LIMITS = Limits(seconds=5, memory_mib=300)

#: Every attack by its name.
ENTRIES = {
    name: f"{module.__name__}:{name}"
    for module in (attacks, wall_attacks)
    for name, value in vars(module).items()
    if callable(value) and getattr(value, "__module__", None) == module.__name__
}


def open_sandbox(folder: Path, strongest: Confinement = Confinement.process, **settings: Any) -> Sandbox:
    """Open a sandbox with every attack and 12 bytes of images; by default with measures that need no special kernel."""
    images = folder / "images.npy"
    np.save(images, np.ones((12,), np.uint8))
    return Sandbox(
        entries=ENTRIES,
        environment=environment(Numerics.portable),
        arrays={"images": images},
        strongest=strongest,
        **settings,
    )


def answer(sandbox: Sandbox, entry: str, header: Any = None) -> Any:
    """Run an attack that must answer with one frame; return its header."""
    finished = sandbox.run(entry, header, b"", LIMITS)
    assert isinstance(finished, Finished), finished
    (frame,) = finished.frames
    return frame.header
