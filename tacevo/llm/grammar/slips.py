"""The faults of real models, one at a time, to exercise the gate."""

import re
from enum import StrEnum

import numpy as np

from tacevo.llm.grammar.edits import edits
from tacevo.llm.grammar.network import Network
from tacevo.llm.grammar.rendering import render
from tacevo.llm.grammar.variations import pick


class Slip(StrEnum):
    """The slip of an answer: what goes wrong with it."""

    # in form only: a good extraction still finds the class
    prose = "prose"
    no_fence = "no_fence"
    # for good
    wrong_channels = "wrong_channels"
    cut_off = "cut_off"
    no_super = "no_super"
    undefined_name = "undefined_name"
    wrong_outputs = "wrong_outputs"
    missing_import = "missing_import"
    foreign_import = "foreign_import"


#: Three slips in ten are harmless; of these, most are talk around the code.
_ODDS = (Slip.prose, Slip.prose, Slip.no_fence, *(slip for slip in Slip if slip not in {Slip.prose, Slip.no_fence}))


def proper(network: Network, parent: str | None = None) -> str:
    """Answer without a fault: one fenced block and nothing else; edits of a parent where one is given."""
    return _written(render(network), parent)


def draw(slip_rate: float, rng: np.random.Generator) -> Slip | None:
    """Decide whether an answer carries a fault, with a probability in [0, 1], and which."""
    return pick(rng, _ODDS) if rng.random() < slip_rate else None


def spoil(network: Network, slip: Slip, rng: np.random.Generator, parent: str | None = None) -> str:
    """Answer with a network's source text, or as edits of a parent, and exactly one fault in it."""
    source = render(network)
    match slip:
        case Slip.prose:
            return _explained(_written(source, parent))
        case Slip.no_fence:
            return _shortest(source, parent)
        case Slip.cut_off:
            text = _shortest(source, parent)
            end = len(text) * int(rng.integers(40, 80)) // 100
            return f"```python\n{text[:end]}"
        case _:
            return _written(_damaged(source, network, slip), parent)


def _damaged(source: str, network: Network, slip: Slip) -> str:
    """Put a fault into the source that leaves it valid Python."""
    result = f"return self.{network.signature.head_name}(x)"
    width = network.signature.output_argument
    match slip:
        case Slip.wrong_channels:
            opening = rf"(self\.conv{len(network.blocks)} = (?:nn\.Sequential\(\s*nn\.Conv2d|ConvBlock)\(\s*)(\w+)"
            return re.sub(opening, r"\g<1>2 * \g<2>", source)
        case Slip.no_super:
            return _replace_last(source, "        super().__init__()\n", "")
        case Slip.undefined_name:
            return _replace_last(source, result, f"x = self.feature_norm(x)\n        {result}")
        case Slip.wrong_outputs:
            return _replace_last(source, f", {width}),", f", {width} + 1),")
        case Slip.foreign_import:
            return f"from torchvision import transforms\n\n\n{source}"
        case _:  # missing_import
            return source.replace("nn.Flatten()", 'einops.layers.torch.Rearrange("n c h w -> n (c h w)")')


def _written(source: str, parent: str | None) -> str:
    """Write a source as one fenced block, of the whole or of edits."""
    return _fenced(_shortest(source, parent))


def _shortest(source: str, parent: str | None) -> str:
    return source if parent is None else edits(parent, source)


def _fenced(text: str) -> str:
    return f"```python\n{text}```\n"


def _explained(block: str) -> str:
    """Surround the code with talk, as chat models do in spite of the format rules."""
    return (
        "Certainly! Here is a version of the network that follows your instruction:\n\n"
        f"{block}\n"
        "The names of the unchanged layers stay as they were. Build it with `in_channels` and train it like its "
        "parent.\n"
    )


def _replace_last(text: str, old: str, new: str) -> str:
    """Replace the last occurrence, the one in the network's own class or in its head."""
    before, _, after = text.rpartition(old)
    return before + new + after
