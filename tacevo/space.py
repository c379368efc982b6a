"""A closed space of networks, as the choices of each gene; `tacevo.llm.grammar.space` makes networks of them."""

from dataclasses import dataclass, fields
from math import prod
from typing import Annotated, Literal

from annotated_types import Ge, Le, Lt, MinLen

from tacevo.records import Record


@dataclass(frozen=True, slots=True, kw_only=True)
class Space(Record):
    """Every combination of one value a gene is a network; the values of a gene are distinct."""

    #: Blocks. Beyond the third they do not halve the map.
    depth: Annotated[tuple[Annotated[int, Ge(2), Le(6)], ...], MinLen(1)]
    #: Channels of the first block; the others have 2, 4 and then again 4 times as many.
    width: Annotated[tuple[Annotated[int, Ge(8), Le(128)], ...], MinLen(1)]
    #: The activation functions in trunk and head.
    activation: Annotated[tuple[Literal["relu", "leaky_relu", "gelu", "silu", "elu"], ...], MinLen(1)]
    #: The normalisation of each block.
    norm: Annotated[tuple[Literal["none", "batch", "group"], ...], MinLen(1)]
    #: The layers by which blocks halve the map.
    down: Annotated[tuple[Literal["max", "average", "stride"], ...], MinLen(1)]
    #: Whether the second block is bypassed.
    residual: Annotated[tuple[bool, ...], MinLen(1)]
    #: The layers that bring the map to a grid of 4 x 4 cells.
    pooling: Annotated[tuple[Literal["average", "max", "both"], ...], MinLen(1)]
    #: Width of the head's only hidden layer.
    hidden: Annotated[tuple[Annotated[int, Ge(16), Le(2048)], ...], MinLen(1)]
    #: Probability of a dropout behind it; 0 means no such layer.
    dropout: Annotated[tuple[Annotated[float, Ge(0), Lt(0.9)], ...], MinLen(1)]

    def __post_init__(self) -> None:
        """Raise ValueError where a value comes twice, so that two genomes would be one network."""
        for field in fields(self):
            values = getattr(self, field.name)
            if len(set(values)) < len(values):
                raise ValueError(f"distinct values of {field.name}")

    @property
    def size(self) -> int:
        """The number of networks."""
        return prod(len(getattr(self, field.name)) for field in fields(self))
