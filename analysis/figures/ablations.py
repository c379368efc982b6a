"""The arms of a sweep: how they went, generation by generation, and where every seed of them ended."""

from itertools import cycle
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.axes import (
    beside,
    boxes,
    count_along,
    forest_axes,
    interval,
    name_coinciding,
    on_loss_axis,
    spread,
)
from analysis.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    house_style,
    new_figure,
)
from analysis.rounding import shown
from analysis.sweeps.ablation import CURVES, QUARTILES, Ablation, by_generation
from analysis.sweeps.arm_metrics import FRACTIONS, LESS_IS_BETTER, Metric
from analysis.table import PValue
from tacevo.results.sweep import ALPHA

#: A name of Matplotlib's, or an offset with the lengths of dashes and gaps.
_Dash = str | tuple[int, tuple[int, ...]]

_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY)

_DASHES: tuple[_Dash, ...] = ("--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1, 1, 1)))

_MARKERS = ("o", "s", "D", "^", "v", "P", "X", "<", ">", "*", "p", "h")

#: In inches: the height of a panel of curves, of an arm's row among final values, and of a further line of its name.
_PANEL, _ROW, _LINE = 2.1, 0.26, 0.1

#: In characters: the widths of the legend, of what the line of an entry takes of it, of a name beside its row, and of
#: the words below all panels.
_LEGEND, _HANDLE, _NAME, _FIGURE = 130, 8, 28, 88

#: The longest line of a name beside an upright axis, in characters.
_UPRIGHT = 15

#: Of a forest plot: inches above and below its rows, and characters of a line below them.
_AROUND, _WIDE = 1.0, 50

#: What final values are drawn of: the words below, and what values are multiplied by.
_ENDS = {
    Metric.test_mse: ("test MSE", 1),
    Metric.test_accuracy: ("test accuracy (%)", 100),
    Metric.test_loss: ("test loss, geometric mean", 1),
    Metric.best_fitness: ("best validation loss", 1),
    Metric.new_quartile: ("new candidates, lower quartile", 1),
    Metric.qd_score: ("QD-score, common archive", 1),
    Metric.coverage: ("coverage (%), common archive", 100),
}

_Values = NDArray[np.float64]


class _Look(NamedTuple):
    """How an arm is drawn; no two of the first 420 arms look alike."""

    colour: str
    dash: _Dash
    marker: str


@house_style()
def curves(ablation: Ablation, frame: pd.DataFrame) -> Figure:
    """Draw best fitness, QD-score and coverage by generation: the median of each arm's seeds over its quartiles."""
    columns = max(1, min(4, _LEGEND // max(len(name) + _HANDLE for name in ablation.names)))
    rows = -(-len(ablation.names) // columns)
    figure, panels = new_figure("double", _PANEL + 0.16 * rows, columns=3)
    for axes, metric in zip(panels, CURVES, strict=True):
        for name, look in _looks(ablation).items():
            values = by_generation(frame, name, metric)
            if len(values):  # some job of it was finished
                _band(axes, values * (100 if metric is Metric.coverage else 1), look, name)
        count_along(axes, "generation")
        name_coinciding(axes)
    on_loss_axis(panels[0], [None if np.isnan(value) else value for value in frame.best_fitness])
    for axes, metric in zip(panels, CURVES, strict=True):
        axes.set_ylabel(fill(_ENDS[metric][0], _UPRIGHT))
    for axes in panels[1:]:
        axes.set_ylim(bottom=0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
    return figure


@house_style()
def final_values(ablation: Ablation) -> Figure:
    """Draw where every run ended, arm by arm, over quartiles (`boxes`); the dotted line is the reference's median."""
    names = [fill(name, _NAME) for name in ablation.names]
    lines = max(name.count("\n") for name in names)
    metrics = [metric for metric in _ENDS if metric in ablation.arms]
    figure, panels = new_figure("double", 0.6 + (_ROW + _LINE * lines) * len(names), columns=len(metrics))
    for axes, metric in zip(panels, metrics, strict=True):
        label, factor = _ENDS[metric]
        samples = [factor * np.array(list(ablation.values(name, metric).values())) for name in ablation.names]
        boxes(axes, samples, range(len(samples)), orientation="horizontal", widths=0.66, whis=(0, 100))
        for place, (values, look) in enumerate(zip(samples, _looks(ablation).values(), strict=True)):
            points = spread(place, len(values))
            axes.plot(values, points, look.marker, color=look.colour, mec="white", mew=0.3, markersize=3.6, zorder=3)
        if ablation.reference is not None and len(samples[0]):
            axes.axvline(float(np.median(samples[0])), color=GREY, linestyle=":", linewidth=0.8, zorder=0)
        axes.set_xlabel(fill(label, _FIGURE // len(metrics)))
        axes.set_yticks(range(len(names)), names, parse_math=False)
        axes.set_ylim(len(names) - 0.5, -0.5)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    return figure


@house_style()
def forest(ablation: Ablation) -> Figure:
    """Draw how much every arm differs from the reference in the first metric (`Ablation.first`), with p after Holm.

    A difference is one of medians; runs that are the reference's own do not enter it. An arm that is not compared has
    its reason in its row.
    """
    metric = ablation.first
    frame = ablation.arms[metric]
    rows = frame[frame.index != ablation.reference]
    names = [fill(name, _NAME) for name in rows.index]
    lines = max([name.count("\n") for name in names], default=0)
    figure, (axes,) = new_figure("single", _AROUND + (_ROW + _LINE * lines) * max(len(rows), 1))
    factor, unit = (100, " (points)") if metric in FRACTIONS else (1, "")
    for place, one in enumerate(rows.itertuples()):
        if np.isnan(one.difference):
            where: dict[str, Any] = {
                "transform": axes.get_yaxis_transform(),
                "va": "center",
                "backgroundcolor": "white",
            }
            axes.text(0.02, place, one.comparability, **where)
            continue
        ends = factor * one.difference_low, factor * one.difference_high
        is_shown = bool(one.p_holm <= ALPHA)
        colour = BLUE if is_shown else GREY
        interval(axes, place, factor * one.difference, ends, colour=colour, marker="o", is_filled=is_shown)
        beside(axes, place, shown(PValue(one.p_holm)))
    axes.set_yticks(range(len(rows)), names, parse_math=False)
    sides = ("better", "worse") if metric in LESS_IS_BETTER else ("worse", "better")
    label = f"{metric.value}{unit}: arm less {ablation.reference}, medians"
    forest_axes(axes, len(rows), fill(label, _WIDE), sides, "p after Holm")
    return figure


def _looks(ablation: Ablation) -> dict[str, _Look]:
    """Return every arm a colour, a dash and a marker of its own; the reference is black and solid."""
    looks = map(_Look, cycle(_COLOURS), cycle(_DASHES), cycle(_MARKERS))
    black = _Look(BLACK, "-", "o")
    return {name: black if name == ablation.reference else next(looks) for name in ablation.names}


def _band(axes: Axes, values: _Values, look: _Look, name: str) -> None:
    """Draw the median of an arm's seeds over the band between its quartiles."""
    generations = np.arange(values.shape[1])
    low, middle, high = np.quantile(values, QUARTILES, axis=0)
    axes.fill_between(generations, low, high, color=look.colour, alpha=0.15, linewidth=0)
    (line,) = axes.plot(generations, middle, color=look.colour, label=name, clip_on=False, zorder=3)
    line.set(marker=look.marker, markevery=max(1, len(generations) // 6), linestyle=look.dash)
