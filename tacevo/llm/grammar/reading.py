"""The parts of a network, read from plain syntax trees: blocks, attention, head.

Every function raises `UnreadableError` where it does not find what it reads.
"""

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import TypeVar, cast

from tacevo.llm.grammar.network import Activation, Attention, Block, Down, Head, Hidden, Norm, Output
from tacevo.text import parse_python


class UnreadableError(ValueError):
    """The source is not a network of the grammar; the message is part of the answer, so it must not change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A call of a layer; every part is source text."""

    name: str
    arguments: tuple[str, ...]
    keywords: dict[str, str]


def plain_tree(source: str) -> ast.Module:
    """Parse source text and take away what does not change the network.

    Gone are imports, docstrings and annotations; constant arithmetic is worked out, and a few layers that can be
    written in several ways are written in one.
    """
    try:
        return cast(ast.Module, _Plain().visit(parse_python(source)))
    except (SyntaxError, ValueError) as error:  # ValueError: a null byte
        raise UnreadableError(f"the source is not valid Python: {error}") from error
    except RecursionError as error:
        raise UnreadableError("the source is nested too deeply") from error


def read_call(node: ast.AST) -> Call:
    """Take a call apart."""
    if not isinstance(node, ast.Call):
        raise UnreadableError(f"`{ast.unparse(node)}` stands where a layer was expected")
    return Call(
        name=ast.unparse(node.func),
        arguments=tuple(ast.unparse(argument) for argument in node.args),
        keywords={keyword.arg or "**": ast.unparse(keyword.value) for keyword in node.keywords},
    )


class _Plain(ast.NodeTransformer):
    """Rewrites a tree into its plain form, from the leaves up."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [statement for statement in node.body if not _is_docstring(statement)]
        return node

    def visit_Module(self, node: ast.Module) -> ast.Module:
        self.generic_visit(node)
        node.body = [each for each in node.body if not isinstance(each, ast.Import | ast.ImportFrom)]
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        self.generic_visit(node)
        node.returns = None
        for argument in node.args.args:
            argument.annotation = None
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        self.generic_visit(node)
        return ast.Name("nn", ctx=ast.Load()) if ast.unparse(node) == "torch.nn" else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        self.generic_visit(node)
        left, right = node.left, node.right
        if (
            isinstance(node.op, ast.Mult)
            and isinstance(left, ast.Constant)
            and isinstance(right, ast.Constant)
            and isinstance(left.value, int)
            and isinstance(right.value, int)
        ):
            return ast.Constant(left.value * right.value)
        return node

    def visit_Call(self, node: ast.Call) -> ast.Call:
        self.generic_visit(node)
        name = ast.unparse(node.func)
        if name == "super":
            node.args = []
        if name == "nn.Conv2d" and len(node.args) > 2:
            names = ("kernel_size", "stride", "padding")
            node.keywords += [
                ast.keyword(arg=arg, value=value) for arg, value in zip(names, node.args[2:], strict=False)
            ]
            node.args = node.args[:2]
        node.keywords = [keyword for keyword in node.keywords if keyword.arg != "inplace"]
        if len(node.keywords) == 1 and not node.args and node.keywords[0].arg in {"p", "kernel_size", "output_size"}:
            node.args, node.keywords = [node.keywords[0].value], []
        if name.startswith("nn.Adaptive") and len(node.args) == 1 and isinstance(node.args[0], ast.Constant):
            node.args = [ast.Tuple([node.args[0], node.args[0]], ctx=ast.Load())]
        node.keywords.sort(key=lambda keyword: keyword.arg or "")
        return node


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


_Member = TypeVar("_Member", bound=StrEnum)


def method(node: ast.ClassDef, name: str) -> ast.FunctionDef:
    """Find a method of a class."""
    for statement in node.body:
        if isinstance(statement, ast.FunctionDef) and statement.name == name:
            return statement
    raise UnreadableError(f"class {node.name} has no method {name}")


def attributes_of(constructor: ast.FunctionDef) -> dict[str, ast.expr]:
    """Collect what a constructor assigns to `self`, by name."""
    return {
        statement.targets[0].attr: statement.value
        for statement in constructor.body
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Attribute)
    }


def required(attributes: Mapping[str, ast.expr], name: str) -> ast.expr:
    """Look up an attribute."""
    if name not in attributes:
        raise UnreadableError(f"the constructor does not set self.{name}")
    return attributes[name]


def read_attention(node: ast.expr) -> Attention:
    """Read the attention module that stands before the adaptive pooling."""
    return _attention([read_call(node)])


def read_block(node: ast.expr) -> Block:
    """Read one block, be it a Sequential or an instance of the custom module."""
    shape, layers = _custom_block(node) if read_call(node).name == "ConvBlock" else _sequential_block(node)
    return Block(
        channels=_number(shape.arguments[1:2]),
        kernel=_number([shape.keywords.get("kernel_size", "")]),
        separable=shape.keywords.get("separable") == "True",
        norm=_first(Norm, [layer.name for layer in layers]) or Norm.none,
        activation=_activation(layers),
        attention=_attention(layers),
        dropout=_rate(layers, "nn.Dropout2d"),
        down=_down(shape, layers),
    )


def _custom_block(node: ast.expr) -> tuple[Call, list[Call]]:
    """Split a ConvBlock into its own arguments and the layers it is given."""
    keywords = node.keywords if isinstance(node, ast.Call) else []
    listed = next((keyword.value for keyword in keywords if keyword.arg == "layers"), None)
    if not isinstance(listed, ast.List):
        raise UnreadableError(f"a list of layers was expected in `{ast.unparse(node)}`")
    return read_call(node), [read_call(item) for item in listed.elts]


def _sequential_block(node: ast.expr) -> tuple[Call, list[Call]]:
    """Split a Sequential into the convolution, in the arguments of a ConvBlock, and the layers that follow."""
    layers = _sequence(node)
    convolutions = [layer for layer in layers if layer.name == "nn.Conv2d"]
    if not convolutions:
        raise UnreadableError(f"a convolution was expected in `{ast.unparse(node)}`")
    first, last = convolutions[0], convolutions[-1]
    keywords = {**first.keywords, "separable": str(first is not last)}
    return Call(name="ConvBlock", arguments=last.arguments, keywords=keywords), layers


def _down(shape: Call, layers: Sequence[Call]) -> Down:
    if shape.keywords.get("stride") == "2":
        return Down.stride
    return _first(Down, [_text(layer) for layer in layers]) or Down.none


def read_head(classes: Mapping[str, ast.ClassDef], node: ast.expr) -> Head:
    """Read the head, be it a Sequential or a class of its own.

    Args:
        classes: every class of the source, by name.
        node: what the network's constructor assigns to the head's attribute.
    """
    own_module = read_call(node).name == "Head"
    if own_module:
        if "Head" not in classes:
            raise UnreadableError("class Head is used but not defined")
        node = required(attributes_of(method(classes["Head"], "__init__")), "layers")
    layers = _sequence(node)
    starts = [index for index, layer in enumerate(layers) if layer.name == "nn.Linear"]
    if not starts:
        raise UnreadableError("the head has no linear layer")
    return Head(
        hidden=tuple(_hidden(layers[start:end]) for start, end in pairwise(starts)),
        input_dropout=_rate(layers[: starts[0]], "nn.Dropout"),
        output=_first(Output, [_text(layer) for layer in layers[starts[-1] :]]) or Output.free,
        own_module=own_module,
    )


def _hidden(layers: Sequence[Call]) -> Hidden:
    """Read a hidden layer from its linear layer on."""
    return Hidden(
        width=_number(layers[0].arguments[1:2]),
        layer_norm=any(layer.name == "nn.LayerNorm" for layer in layers),
        activation=_activation(layers),
        dropout=_rate(layers, "nn.Dropout"),
    )


def _sequence(node: ast.expr) -> list[Call]:
    """Read the layers of a Sequential."""
    if not isinstance(node, ast.Call) or ast.unparse(node.func) != "nn.Sequential":
        raise UnreadableError(f"an nn.Sequential was expected; found `{ast.unparse(node)}`")
    return [read_call(item) for item in node.args]


def _text(call: Call) -> str:
    """Write a layer again as source text, in the form that the enums use."""
    keywords = [f"{name}={value}" for name, value in call.keywords.items()]
    return f"{call.name}({', '.join([*call.arguments, *keywords])})"


def _activation(layers: Sequence[Call]) -> Activation:
    found = _first(Activation, [_text(layer) for layer in layers])
    if found is None:
        raise UnreadableError(f"no known activation among the layers {', '.join(layer.name for layer in layers)}")
    return found


def _attention(layers: Sequence[Call]) -> Attention:
    return _first(Attention, [layer.name for layer in layers]) or Attention.none


def _first(kind: type[_Member], texts: Sequence[str]) -> _Member | None:
    """Find the first text that is a member's value."""
    members = {member.value: member for member in kind if member.value}
    return next((members[text] for text in texts if text in members), None)


def _rate(layers: Sequence[Call], name: str) -> float:
    """Read the probability of the first dropout of that kind; 0 without one."""
    for layer in layers:
        if layer.name == name:
            return _real(layer.arguments)
    return 0.0


def _real(texts: Sequence[str]) -> float:
    try:
        return float(texts[0])
    except (IndexError, ValueError) as error:
        raise UnreadableError(f"a number was expected; found {texts or 'nothing'}") from error


def _number(texts: Sequence[str]) -> int:
    if not texts or not texts[0].isdecimal():
        raise UnreadableError(f"a whole number was expected; found {texts or 'nothing'}")
    return int(texts[0])
