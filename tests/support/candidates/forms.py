"""Which layers, functions and tensor operations a network's source uses, and all that recorded answers and grammar use.

A form is one word: the gate's spelling of an operation (`conv2d` for `nn.Conv2d` and `F.conv2d`), with the shapes of a
convolution apart, because each takes other code.
"""

import ast
from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from typing import Any, TypeVar, get_type_hints

import torch
from gate_cases import completion, contract, examples, extracted

from tacevo.gate.operations import is_factory, operation
from tacevo.llm.grammar.network import Block, Head, Hidden, Network, Signature
from tacevo.llm.grammar.rendering import render
from tacevo.records import Rejection

_Record = TypeVar("_Record", Block, Hidden, Head, Network)

#: Calls that compute nothing: containers, and what only looks at a tensor.
_NOTHING = frozenset(["module", "sequential", "modulelist", "parameter", "size", "dim", "numel", "item"])

_SIGNATURE = Signature(
    class_name="Net", in_channels=3, output_argument="num_outputs", outputs=3, head_name="head", docstring=""
)


def forms(source: str) -> frozenset[str]:
    """Name every form that a network's text uses, whether or not it runs."""
    seen: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call():
                seen.update(_forms_of_call(node))
            case ast.BinOp(op=ast.Pow()):
                seen.add("pow")
            case ast.BinOp(op=ast.MatMult()):
                seen.add("matmul")
    return frozenset(seen)


def _forms_of_call(call: ast.Call) -> Iterator[str]:
    """Name what one call computes; nothing where it calls a part of the network, or what does not belong to torch."""
    if not isinstance(call.func, ast.Attribute):
        return
    owner, name = ast.unparse(call.func.value), call.func.attr
    of_torch = owner.split(".")[0] in ("torch", "nn", "F")
    if owner == "self" or name.startswith("__") or not (of_torch or hasattr(torch.Tensor, name)):
        return
    op = operation(name).replace("_", "")
    if op in _NOTHING or is_factory(op):
        return
    yield op
    if op.startswith("conv"):
        yield from (f"{op} {word.arg}" for word in call.keywords if word.arg in ("dilation", "groups", "stride"))


def forms_of_answers() -> frozenset[str]:
    """Name every form in the recorded answers from which a source can be extracted."""
    seen: frozenset[str] = frozenset()
    for answer in examples("llm_answers"):
        source = extracted(completion(answer["response"], answer["stop_reason"]), contract(answer["task"]))
        seen |= frozenset() if isinstance(source, Rejection) else forms(source)
    return seen


def forms_of_grammar() -> frozenset[str]:
    """Name every form that the grammar can write, by writing each choice of each of its records once."""
    return frozenset().union(*map(forms, sources_of_grammar()))


def sources_of_grammar() -> Iterator[str]:
    """Write each choice of each of the grammar's records once; each source defines a class `Net`."""
    return map(render, _networks())


def _networks() -> Iterator[Network]:
    """Return networks that hold every value of every enumeration, every flag, and every kind of skip."""
    plain = Block(channels=8)
    blocks = [*_varied(plain), replace(plain, dropout=0.1), replace(plain, separable=True, kernel=5)]
    layers = [*_varied(Hidden(width=16)), Hidden(width=16, dropout=0.1)]
    heads = _varied(Head(hidden=(Hidden(width=16),), input_dropout=0.1))
    network = Network(signature=_SIGNATURE, blocks=(plain, plain), head=Head(hidden=()))
    yield from (replace(network, blocks=(plain, block)) for block in blocks)
    yield from (replace(network, head=Head(hidden=(layer,))) for layer in layers)
    yield from (replace(network, head=head) for head in heads)
    yield from _varied(network)
    yield from (replace(network, skips=skips) for skips in (((0, 1),), ((1, 2),), ((0, 2), (1, 2))))


def _varied(record: _Record) -> Iterator[_Record]:
    """Return a record with each value of each of its enumerations and flags in turn."""
    for name, kind in get_type_hints(type(record)).items():
        choices: list[Any] = [False, True] if kind is bool else []
        if isinstance(kind, type) and issubclass(kind, StrEnum):
            choices = list(kind)
        yield from (replace(record, **{name: choice}) for choice in choices)
