"""The parser from PyTorch code to a network of the grammar.

The reader looks for the parts of a network where the grammar writes them; then it writes what it has read, and compares
the two texts. Equal texts prove that nothing was overlooked or misread.
"""

import ast
import re
from enum import StrEnum
from functools import lru_cache
from typing import TypeVar

from tacevo.llm.grammar.network import (
    Activation,
    Attention,
    Block,
    Down,
    Head,
    Hidden,
    Network,
    Norm,
    Output,
    Pooling,
    Signature,
)
from tacevo.llm.grammar.rendering import render
from tacevo.text import parse_python

_HELPERS = {"SpatialAttention", "ChannelAttention", "ConvBlock", "Head"}

_Member = TypeVar("_Member", bound=StrEnum)


class UnreadableError(ValueError):
    """The source is not a network as the grammar writes it; the message is part of the answer."""


@lru_cache(maxsize=4096)  # a parent is read for each of its children
def parse(source: str) -> Network:
    """Read a network from source text, whatever its layout, imports, comments and docstrings.

    Raises:
        UnreadableError: the text is not Python, or is a network that the grammar would not write so.
    """
    text, docstrings = _plain(source)
    names = [name for name in docstrings if name not in _HELPERS]
    if len(names) != 1:
        raise UnreadableError(f"one network class was expected beside the helpers; found {names or 'none'}")
    try:
        network = _network(text, names[0], docstrings[names[0]])
    except UnreadableError:
        raise
    except ValueError as error:
        raise UnreadableError(str(error)) from error
    written, _ = _plain(render(network))
    if text != written:
        known = set(written.splitlines())
        strange = [line.strip() for line in text.splitlines() if line not in known]
        raise UnreadableError(f"`{strange[0] if strange else 'the order of the statements'}` is beyond its grammar")
    return network


def _plain(source: str) -> tuple[str, dict[str, str]]:
    """Write a source with one statement a line and without imports, comments and docstrings.

    Returns:
        That text; the first line of each class's docstring, by the class's name, without what would need escaping.
    """
    try:
        tree = parse_python(source)
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        summaries = {node.name: (ast.get_docstring(node) or "").partition("\n")[0] for node in classes}
        tree.body = [each for each in tree.body if not isinstance(each, ast.Import | ast.ImportFrom)]
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                node.body = [statement for statement in node.body if not _is_docstring(statement)]
        return ast.unparse(tree), {name: re.sub(r'["\\]', "", text).strip() for name, text in summaries.items()}
    except (SyntaxError, ValueError) as error:  # ValueError: a null byte
        raise UnreadableError(f"the source is not valid Python: {error}") from error
    except RecursionError as error:
        raise UnreadableError("the source is nested too deeply") from error


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _network(text: str, name: str, docstring: str) -> Network:
    """Put a network together from the statements of its class."""
    _, _, own = text.partition(f"class {name}(")
    constructor = _search(r"__init__\(self, in_channels=(\d+), (\w+)=(\d+)\)", own, "a constructor (in_channels=...)")
    in_channels, output_argument, outputs = constructor.groups()
    head_name = _search(r"return self\.(\w+)\(x\)$", own, "a last line such as `return self.regressor(x)`")[1]
    attention = re.search(r"self\.attention = (.*)", own)
    pool = _search(r"self\.adaptive_pool = nn\.Adaptive(Avg|Max)Pool2d\(\((\d+),", own, "self.adaptive_pool")
    pooling = Pooling.max if pool[1] == "Max" else Pooling.average
    return Network(
        signature=Signature(
            class_name=name,
            in_channels=int(in_channels),
            output_argument=output_argument,
            outputs=int(outputs),
            head_name=head_name,
            docstring=docstring,
        ),
        blocks=_blocks(own),
        skips=_skips(own),
        attention=(attention and _first(Attention, attention[1])) or Attention.none,
        pooling=Pooling.both if "self.adaptive_max_pool = " in own else pooling,
        grid=int(pool[2]),
        head=_head(text, _search(rf"self\.{head_name} = (.*)", own, f"self.{head_name}")[1]),
        block_module="self.conv1 = ConvBlock(" in own,
    )


def _blocks(own: str) -> tuple[Block, ...]:
    """Read conv1, conv2, ... up to the first gap."""
    blocks: list[Block] = []
    while line := re.search(rf"self\.conv{len(blocks) + 1} = (.*)", own):
        blocks.append(_block(line[1]))
    return tuple(blocks)


def _block(line: str) -> Block:
    """Read one block, be it a Sequential or an instance of the custom module."""
    channels = re.findall(r"(?:nn\.Conv2d|ConvBlock)\(\w+, (\d+)", line)
    if not channels:
        raise UnreadableError(f"a convolution was expected in `{line}`")
    return Block(
        channels=int(channels[-1]),
        kernel=int(_search(r"kernel_size=(\d+)", line, "kernel_size=...")[1]),
        separable=line.count("nn.Conv2d(") == 2 or "separable=True" in line,
        norm=_first(Norm, line) or Norm.none,
        activation=_activation(line),
        attention=_first(Attention, line) or Attention.none,
        dropout=_rate("nn.Dropout2d", line),
        down=_first(Down, line) or Down.none,
    )


def _skips(own: str) -> tuple[tuple[int, int], ...]:
    """Read the residual connections from the forward pass."""
    skips, block = [], 0
    for step in re.finditer(r"x = self\.conv(\d+)\(x\)|x = x \+ .*?\bskip(\d+)\b", own):
        if step[1]:
            block = int(step[1])
        else:
            skips.append((int(step[2]), block))
    return tuple(sorted(skips))


def _head(text: str, line: str) -> Head:
    """Read the head, be it a Sequential or a class of its own."""
    own_module = line.startswith("Head(")
    if own_module:
        _, _, head = text.partition("class Head(nn.Module):")
        line = _search(r"self\.layers = (.*)", head, "the layers of class Head")[1]
    first, *hidden = line.split("nn.Linear(")
    if not hidden:
        raise UnreadableError("the head has no linear layer")
    return Head(
        hidden=tuple(map(_hidden, hidden[:-1])),
        input_dropout=_rate("nn.Dropout", first),
        output=_first(Output, hidden[-1]) or Output.free,
        own_module=own_module,
    )


def _hidden(part: str) -> Hidden:
    """Read a hidden layer from the arguments of its linear layer on."""
    return Hidden(
        width=int(_search(r"^[^)]*, (\d+)\)", part, "the width of a hidden layer")[1]),
        layer_norm="nn.LayerNorm(" in part,
        activation=_activation(part),
        dropout=_rate("nn.Dropout", part),
    )


def _activation(text: str) -> Activation:
    activation = _first(Activation, text)
    if activation is None:
        raise UnreadableError(f"no known activation in `{text}`")
    return activation


def _first(kind: type[_Member], text: str) -> _Member | None:
    """Find the first member whose value stands in a text."""
    return next((member for member in kind if member.value and member.value in text), None)


def _rate(name: str, text: str) -> float:
    """Read the probability of the first dropout of that kind; 0 without one."""
    dropout = re.search(rf"{re.escape(name)}\(([\d.]+)\)", text)
    return float(dropout[1]) if dropout else 0.0


def _search(pattern: str, text: str, expected: str) -> re.Match[str]:
    match = re.search(pattern, text)
    if match is None:
        raise UnreadableError(f"{expected} was expected")
    return match
