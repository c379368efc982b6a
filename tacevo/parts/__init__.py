"""Parts: what plugs into a search, a study or a report, ours and other people's.

A part is a class of one kind (`tacevo.parts.kinds`), chosen by its name in a setting such as `proposals.parents`. It
comes with tacevo, from an installed package (an entry point of the group `tacevo.parents`, `tacevo.sources`, ...), or
from a file, as in `proposals.parents=parts/parents.py:Lexicase`. docs/parts.md says how to write one.

What decides the results of a run (parents, prompts, temperatures, archives, descriptors, fitness) never runs in the
process that searches, unless it is ours: it runs confined, its sources are recorded, and its decisions are entries of a
store. Their classes are those of this module; the protocols of all others stand in `tacevo.parts.source`, `provider`,
`executor`, `tracker` and `output`.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tacevo.parts.protocols import (
        Archive,
        Candidate,
        Descriptor,
        Fitness,
        Generation,
        Parents,
        Population,
        PromptHistory,
        Prompts,
        Temperature,
        Trial,
    )

__all__ = [
    "Archive",
    "Candidate",
    "Descriptor",
    "Fitness",
    "Generation",
    "Parents",
    "Population",
    "PromptHistory",
    "Prompts",
    "Temperature",
    "Trial",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: NumPy takes a while."""
    if name not in __all__:
        raise AttributeError(f"module 'tacevo.parts' has no attribute {name!r}")
    return getattr(importlib.import_module("tacevo.parts.protocols"), name)


def __dir__() -> list[str]:
    """List the public names."""
    return list(__all__)
