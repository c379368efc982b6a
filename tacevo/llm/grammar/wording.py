"""The things that an instruction's words mention: blocks, numbers, factors, names of layers."""

import re

from tacevo.llm.grammar.network import Activation

_ORDINALS = {"first": 1, "second": 2, "third": 3, "fourth": 4, "fifth": 5, "sixth": 6}

_ACTIVATIONS = {
    r"leaky[ -]?relu": Activation.leaky_relu,
    r"gelu": Activation.gelu,
    r"silu|swish": Activation.silu,
    r"elu": Activation.elu,
    r"relu": Activation.relu,
}

_GIVEN_UP = (
    r"(?:replac\w*|exchang\w*|swap\w*|chang\w*|turn\w*|instead of|in place of|rather than|from)"
    r"(?: (?:the|an?|each|every|all|any))*"
)

_LEFT_ALONE = r"\b(?:keep|keeps|leave|leaves|unchanged|untouched|alone)\b"

_REMOVAL = r"\b(?:remov\w*|delet\w*|omit\w*|discard\w*|strip\w*|drop|without|no|get rid of|take|takes|free of)\b"


def operative(instruction: str) -> str:
    """Lower-case an instruction and cut the clauses that only say what stays as it is."""
    text = " ".join(instruction.lower().split())
    clauses = re.split(r"[;:,.()]+(?:\s+|$)|\s+\(", text)
    kept = [clause for clause in clauses if not re.search(_LEFT_ALONE, clause)]
    return "; ".join(clause for clause in kept if clause) or text


def mentions(text: str, pattern: str) -> bool:
    """Return whether a pattern occurs at the start of a word."""
    return re.search(rf"\b(?:{pattern})", text) is not None


def removes(text: str, pattern: str) -> bool:
    """Return whether the text asks to do without something, within one clause."""
    return re.search(rf"{_REMOVAL}[^;.,]{{0,30}}\b(?:{pattern})", text) is not None


def named_blocks(text: str, count: int) -> list[int]:
    """List the blocks that a text names, in order, each at most `count`; empty if it names none.

    A block that the network does not have stands for its last one, because the baseline's names survive in the
    instructions while networks shrink.
    """
    named = [int(digit) for digit in re.findall(r"\bconv(?:olution)?(?:al)?(?: block| layer)? ?(\d)\b", text)]
    noun = r"(?: \w+)? (?:conv\w*|block|stage)"
    named += [number for word, number in _ORDINALS.items() if re.search(rf"\b{word}{noun}", text)]
    if re.search(rf"\b(?:last|final){noun}", text):
        named.append(count)
    return sorted({min(number, count) for number in named if number > 0})


def kernel_size(text: str) -> int | None:
    """Read the side of a kernel, as in `5x5 kernel` or `kernel size of 7`."""
    square = re.search(r"\b(\d+) ?(?:x|\u00d7|by|-by-) ?\1\b", text)
    spoken = re.search(r"kernels?(?: sizes?)?(?: of| to| =|:)? (\d+)\b", text)
    side = square or spoken
    return int(side[1]) if side else None


def scale(text: str) -> float | None:
    """Read a factor, as in `halve`, `twice as wide`, `a quarter more`, `25 % fewer`."""
    less = mentions(text, r"fewer|less|narrow|reduc|shrink|smaller|cut")
    percent = re.search(r"(\d+(?:\.\d+)?) ?(?:%|percent|per cent)", text)
    if percent or mentions(text, "quarter"):
        share = float(percent[1]) / 100 if percent else 0.25
        return 1 - share if less else 1 + share
    if mentions(text, r"halv|half"):
        return 0.5
    return 2.0 if mentions(text, r"doubl|twice|two times") else None


def whole_number(text: str) -> int | None:
    """Read the number that a size is to have: the one after `to`, else the last of two or more digits."""
    target = re.search(r"\bto (\d{2,})\b", text)
    numbers = re.findall(r"(?<![\d.x])\d{2,}(?![\dx%]|\.\d| %)", text)
    if target:
        return int(target[1])
    return int(numbers[-1]) if numbers else None


def probability(text: str) -> float | None:
    """Read a probability, as in `0.6` or `60 %`."""
    fraction = re.search(r"(?<![\d.])0?\.\d+", text)
    percent = re.search(r"(\d+) ?(?:%|percent)", text)
    if fraction:
        return float(fraction[0])
    return int(percent[1]) / 100 if percent else None


def activation(text: str) -> Activation | None:
    """Find the activation that is wanted: the first one named that is not given up for another."""
    wanted = [
        (match.start(), member)
        for pattern, member in _ACTIVATIONS.items()
        for match in re.finditer(rf"(?<![a-z])(?<!leaky.)(?:{pattern})", text)
        if not re.search(rf"\b{_GIVEN_UP}\s+$", text[: match.start()])
    ]
    return min(wanted)[1] if wanted else None


def gives_up(text: str, pattern: str) -> bool:
    """Return whether the text names something only as what is to be replaced."""
    return re.search(rf"\b{_GIVEN_UP} (?:{pattern})", text) is not None
