"""All forms that the grammar can write (`forms`)."""

from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from typing import Any, TypeVar, get_type_hints

from forms import forms

from tacevo.llm.grammar.network import Block, Head, Hidden, Network, Signature
from tacevo.llm.grammar.rendering import render

_Record = TypeVar("_Record", Block, Hidden, Head, Network)

_SIGNATURE = Signature(
    class_name="Net", in_channels=3, output_argument="num_outputs", outputs=3, head_name="head", docstring=""
)


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
