"""Single networks of a search: where the best came from, and how the best were trained."""

from collections.abc import Mapping, Sequence, Set
from typing import Literal

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures.axes import count_along, name_coinciding, on_loss_axis
from analysis.figures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, house_style, new_figure
from analysis.rounding import shown
from tacevo.data.pictures import WIDTHS, ShownFigure
from tacevo.evolution.lines import CandidateLine
from tacevo.records import Operator

#: Ancestors that a figure shows, at most: the latest.
ROWS = 45

#: Inches of a lineage: above, each row, below.
_HEAD, _ROW, _FOOT = 0.42, 0.15, 0.38

#: Where its texts stand, in widths of its axes.
_PLACES = (1.1, 1.56, 3.17)

Dashes = Literal["-", "--"]

#: How each operator is drawn: colour, marker, dashes.
_OPERATORS: dict[Operator, tuple[str, str, Dashes]] = {
    Operator.baseline: (BLACK, "s", "-"),
    Operator.given: (GREEN, "^", "-"),
    Operator.mutation: (BLUE, "o", "-"),
    Operator.crossover: (ORANGE, "D", "--"),
    Operator.sample: (GREEN, "^", "-"),
}

#: How each network is drawn: colour, marker, dashes.
_LINES = (
    (BLACK, "s", "-"),
    (BLUE, "o", "--"),
    (VERMILLION, "^", "-."),
    (GREEN, "D", ":"),
    (PURPLE, "v", (0, (5, 1, 1, 1))),
    (SKY, "P", (0, (1, 1))),
)


@house_style()
def lineage(ancestors: pd.DataFrame) -> Figure:
    """Draw a network and its ancestors, one below the other, each with what it was made by and its fitness.

    The ancestors stand in the order of the search; the network itself is the last.
    """
    rows = list(ancestors.tail(ROWS).itertuples())
    height = _HEAD + _ROW * len(rows) + _FOOT
    figure = ShownFigure(figsize=(WIDTHS["single"], height))
    axes = figure.add_axes((0.03, _FOOT / height, 0.3, _ROW * len(rows) / height))
    places = {one.Index: (one.generation, row) for row, one in enumerate(rows)}
    for one in rows:
        colour, marker, dashes = _OPERATORS[Operator(one.operator)]
        generation, row = places[one.Index]
        for before, above in (places[parent] for parent in one.parents if parent in places):
            axes.plot([before, generation], [above, row], color=colour, linestyle=dashes, linewidth=0.9)
        axes.plot(generation, row, marker, color=colour, zorder=3, clip_on=False)
        made = one.operator if pd.isna(one.instruction) else one.instruction
        fitness = "" if pd.isna(one.fitness) else shown(one.fitness)
        _write(axes, row, one.Index, made.replace("_", " "), fitness)
    hidden = len(ancestors) - len(rows)
    _write(axes, -1, "network", f"made by ({hidden} left out)" if hidden else "made by", "loss")
    axes.set(ylim=(len(rows) - 0.5, -0.5), yticks=[])
    count_along(axes, "generation", most=4)
    axes.spines["left"].set_visible(False)
    figure.legend(handles=_operators({one.operator for one in rows}), loc="upper center", ncols=3)
    return figure


@house_style()
def training_curves(networks: Sequence[CandidateLine], names: Mapping[str, str] | None = None) -> Figure:
    """Draw the validation loss of trained candidates after each epoch of the search's short training.

    Args:
        networks: trained, at most six, the baseline first.
        names: of those that a study names, by id: `g12s05 (variant 1)`.
    """
    figure, (axes,) = new_figure("single", 2.4)
    drawn: list[float] = []
    for candidate, (colour, marker, dashes) in zip(networks, _LINES, strict=False):
        losses = candidate.validation_losses or ()
        is_baseline = candidate.operator is Operator.baseline
        label = candidate.operator.value if is_baseline else (names or {}).get(candidate.id, candidate.id)
        axes.plot(range(1, len(losses) + 1), losses, color=colour, marker=marker, linestyle=dashes, label=label)
        drawn += losses
    on_loss_axis(axes, drawn)
    count_along(axes, "epoch")
    name_coinciding(axes)
    figure.legend(loc="outside upper center", ncols=2 if names else 3)
    return figure


def _write(axes: Axes, row: int, *texts: str) -> None:
    for place, side, text in zip(_PLACES, ("left", "left", "right"), texts, strict=True):
        axes.text(place, row, text, transform=axes.get_yaxis_transform(), ha=side, va="center", parse_math=False)


def _operators(used: Set[str]) -> list[Line2D]:
    return [
        Line2D([], [], color=colour, marker=marker, linestyle=dashes, label=operator.value)
        for operator, (colour, marker, dashes) in _OPERATORS.items()
        if operator in used
    ]
