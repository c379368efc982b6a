"""From PyTorch code to a network of the grammar.

The reader looks only at the places where it expects the parts of a network; then it writes what it has read and
compares the two plain syntax trees. Equal trees prove that nothing was overlooked or misread.
"""

import ast
import re
from collections.abc import Mapping
from itertools import count, takewhile

from tacevo.llm.grammar.network import Attention, Network, Pooling, Signature
from tacevo.llm.grammar.reading import (
    UnreadableError,
    attributes_of,
    method,
    plain_tree,
    read_attention,
    read_block,
    read_call,
    read_head,
    required,
)
from tacevo.llm.grammar.rendering import render
from tacevo.text import parse_python

_HELPERS = {"SpatialAttention", "ChannelAttention", "ConvBlock", "Head"}


def parse(source: str) -> Network:
    """Read a network from source text, comments and docstrings aside.

    Raises:
        UnreadableError: the text is not Python, or is a network that the grammar cannot say.
    """
    tree = plain_tree(source)
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    names = [name for name in classes if name not in _HELPERS]
    if len(names) != 1:
        raise UnreadableError(f"one network class was expected beside the helpers; found {names or 'none'}")
    network = _network(classes, names[0], _summary(source, names[0]))
    _check_reading(tree, plain_tree(render(network)))
    return network


def _network(classes: Mapping[str, ast.ClassDef], name: str, docstring: str) -> Network:
    """Put a network together from the constructor and the forward pass of its class."""
    constructor = method(classes[name], "__init__")
    head_name, skips = _flow(method(classes[name], "forward"))
    attributes = attributes_of(constructor)
    pool = read_call(required(attributes, "adaptive_pool"))
    pooling = Pooling.max if pool.name == "nn.AdaptiveMaxPool2d" else Pooling.average
    try:
        return Network(
            signature=_signature(constructor, name, head_name, docstring),
            blocks=tuple(read_block(attributes[block]) for block in _block_names(attributes)),
            skips=skips,
            attention=read_attention(attributes["attention"]) if "attention" in attributes else Attention.none,
            pooling=Pooling.both if "adaptive_max_pool" in attributes else pooling,
            grid=_grid(pool.arguments),
            head=read_head(classes, required(attributes, head_name)),
            block_module=read_call(required(attributes, "conv1")).name == "ConvBlock",
        )
    except ValueError as error:
        raise UnreadableError(str(error)) from error


def _check_reading(given: ast.Module, read: ast.Module) -> None:
    """Check that what was read, written again, is what was given."""
    if ast.dump(given) == ast.dump(read):
        return
    known = set(ast.unparse(read).splitlines())
    strange = [line.strip() for line in ast.unparse(given).splitlines() if line not in known]
    raise UnreadableError(f"`{strange[0] if strange else 'the order of the statements'}` is beyond its grammar")


def _summary(source: str, name: str) -> str:
    """Read the first line of a class's docstring, without what would need escaping."""
    classes = (node for node in parse_python(source).body if isinstance(node, ast.ClassDef))
    docstrings = {node.name: ast.get_docstring(node) or "" for node in classes}
    return re.sub(r'["\\]', "", docstrings[name].partition("\n")[0]).strip()


def _signature(constructor: ast.FunctionDef, name: str, head_name: str, docstring: str) -> Signature:
    arguments = [argument.arg for argument in constructor.args.args]
    defaults = [default.value for default in constructor.args.defaults if isinstance(default, ast.Constant)]
    match arguments, defaults:
        case ["self", "in_channels", str(output_argument)], [int(in_channels), int(outputs)]:
            return Signature(
                class_name=name,
                in_channels=in_channels,
                output_argument=output_argument,
                outputs=outputs,
                head_name=head_name,
                docstring=docstring,
            )
    raise UnreadableError(f"a constructor (in_channels=..., outputs=...) was expected; it has {arguments[1:]}")


def _block_names(attributes: Mapping[str, ast.expr]) -> list[str]:
    """List the blocks, conv1, conv2, ... up to the first gap."""
    return list(takewhile(attributes.__contains__, (f"conv{number}" for number in count(1))))


def _grid(arguments: tuple[str, ...]) -> int:
    """Read the side of the pooled map from the argument of an adaptive pooling."""
    found = re.fullmatch(r"\((\d+), \1\)", arguments[0] if arguments else "")
    if not found:
        raise UnreadableError(f"a square grid such as (4, 4) was expected; found {arguments}")
    return int(found[1])


def _flow(forward: ast.FunctionDef) -> tuple[str, tuple[tuple[int, int], ...]]:
    """Read the name of the head and the residual connections from the forward pass."""
    skips: list[tuple[int, int]] = []
    block, head_name = 0, ""
    for statement in forward.body:
        text = ast.unparse(statement)
        if found := re.fullmatch(r"x = self\.conv(\d+)\(x\)", text):
            block = int(found[1])
        elif found := re.fullmatch(r"x = x \+ .*?\bskip(\d+)\b.*", text):
            skips.append((int(found[1]), block))
        elif found := re.fullmatch(r"return self\.(\w+)\(x\)", text):
            head_name = found[1]
    if not head_name:
        raise UnreadableError("forward was expected to end with the head, as in `return self.regressor(x)`")
    return head_name, tuple(sorted(skips))
