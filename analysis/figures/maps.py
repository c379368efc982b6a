"""Maps of both archives: niches in the units of their axes, coloured by what holds them."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from analysis.figures.axes import logarithmic, title_unsent_temperatures
from analysis.figures.style import (
    BLACK,
    COLOUR_MAP,
    GREY,
    OUTLINED,
    PALE,
    SHADE,
    VERMILLION,
    house_style,
    new_figure,
)
from analysis.runs.coverage_map import DIRECTIONS, axis_label
from analysis.runs.niches import Polygon, cells, prompt_rows
from tacevo.choices import Scale
from tacevo.results.run import RecordedRun, descriptors_of

#: (low, high) of both axes, in their units.
Extent = tuple[tuple[float, float], tuple[float, float]]

#: In inches: the height of a map, and of a row of instructions.
HEIGHT, _ROW = 3.1, 0.145

#: Half the height of what fills a row, of which 1 is from one row to the next.
_HALF = 0.42

#: The order of marks, which would be cut by the frame if they were not above it.
_ABOVE = 4

#: The colours of curiosity, which are not those of losses, and of its least value, 0.5.
_CURIOSITY, _LEAST = "Purples", "#F3F1F8"


@house_style()
def network_map(run: RecordedRun, centroids: NDArray[np.float64]) -> Figure:
    """Draw the network archive over its two axes, each niche in the colour of its elite's fitness.

    An elite outside fixed bounds stands at their edge, where its niche was looked up, and has a mark of its own. The
    centroids are those of the network archive, shape (niches, 2), in [0, 1].
    """
    figure, (axes,) = new_figure("single", HEIGHT)
    fitness = {elite.niche: elite.fitness for elite in run.elites}
    extent, scale = _extent(run), run.config.archive.eff_ratio_scale
    own = {candidate.id: descriptors_of(candidate, scale, run.config.archive.axes) for candidate in run.trained}
    places = {elite.id: _clipped(own[elite.id], extent) for elite in run.elites}
    moved = {name for name, place in places.items() if place != own[name]}
    filled = _fill(axes, _placed(centroids, extent), fitness, _loss_scale(list(fitness.values())), f"{COLOUR_MAP}_r")
    _points(axes, [place for name, place in places.items() if name not in moved], "elite")
    if run.elites:
        best = places[run.ranked()[0].id]
        star: dict[str, Any] = {"color": VERMILLION, "markersize": 8, "clip_on": False, "zorder": _ABOVE, **OUTLINED}
        axes.plot(*best, "*", label="best", **star)
        bar = figure.colorbar(filled, label="validation loss of the elite", pad=0.02)
        if isinstance(filled.norm, LogNorm):
            bar.set_label("validation loss of the elite (logarithmic scale)")
            logarithmic(bar.ax.yaxis)
    if moved:
        outside = [places[name] for name in sorted(moved)]
        marks: dict[str, Any] = {"color": BLACK, "markersize": 4.5, "clip_on": False, "zorder": _ABOVE, **OUTLINED}
        axes.plot(*zip(*outside, strict=True), "X", label="outside the bounds", **marks)
    across, up = (_named(axis, scale) for axis in run.config.archive.axes)
    axes.set(xlabel=across, ylabel=up)
    _legend(figure, axes)
    return figure


@house_style()
def prompt_map(run: RecordedRun, centroids: NDArray[np.float64], reachable: Collection[int]) -> Figure:
    """Draw the prompt archive, a row for each instruction over the temperature, coloured by curiosity.

    A row is cut into the niches that its instruction meets: a niche may lie in several rows. One whose trial's child
    the network archive did not take is hatched; one that the run could not reach is shaded; a title says where
    temperatures were not sent. The centroids are those of the prompt archive, shape (niches, 2), in [0, 1];
    `reachable` are the niches that a trial of the run could have.
    """
    rows = prompt_rows(centroids, len(run.instructions))
    figure, (axes,) = new_figure("single", 1.0 + _ROW * len(rows))
    pieces = [(niche, _piece(row, low, high)) for row, cut in enumerate(rows) for niche, low, high in cut]
    trials = {trial.niche: trial for trial in run.prompt_trials}
    legend: list[Patch] = []

    def draw(chosen: Callable[[int], bool], label: str = "", **look: Any) -> None:
        shapes = [piece for niche, piece in pieces if chosen(niche)]
        if shapes:
            axes.add_collection(PolyCollection(shapes, linewidth=0.3, **look))
            if label:
                legend.append(Patch(linewidth=0.3, label=label, **look))

    draw(lambda niche: niche not in trials and niche in reachable, "empty", facecolor=PALE, edgecolor=GREY)
    shade = {"facecolor": SHADE, "edgecolor": GREY, "hatch": "...."}
    draw(lambda niche: niche not in trials and niche not in reachable, "out of reach", **shade)
    held = [(niche, piece) for niche, piece in pieces if niche in trials]
    filled = PolyCollection([piece for _, piece in held], edgecolor=GREY, linewidth=0.3, cmap=_CURIOSITY)
    filled.set(array=[trials[niche].curiosity for niche, _ in held], norm=Normalize(0.5, 2.0))
    axes.add_collection(filled)
    fruitless = {niche for niche, trial in trials.items() if not trial.inserted}
    over: dict[str, Any] = {"edgecolor": GREY, "hatch": "/////"}
    draw(lambda niche: niche in fruitless, facecolor="none", **over)
    if fruitless:
        legend.append(Patch(facecolor=_LEAST, linewidth=0.3, label="child not inserted", **over))
    _points(axes, [(trial.temperature, trial.prompt) for trial in run.prompt_trials], "trial")
    if run.prompt_trials:
        figure.colorbar(filled, label="curiosity of the trial", pad=0.02, ticks=[0.5, 1.0, 1.5, 2.0])
    names = [name.replace("_", " ") for name in run.instructions]
    axes.set_yticks(range(len(rows)), names, parse_math=False)
    axes.tick_params(axis="y", length=0)
    axes.set(xlim=(-0.015, 1.015), ylim=(len(rows) - 0.5, -0.5), xlabel=f"temperature $T_g${run.carried}")
    title_unsent_temperatures(axes, run)
    _legend(figure, axes, legend)
    return figure


def _named(axis: str, scale: Scale) -> str:
    """Write the label of an axis, below it what its ends mean, where they have words."""
    label, ends = axis_label(axis, scale, r"$\log_{10}$"), DIRECTIONS.get(axis)
    return label if ends is None else f"{label}\n\N{LEFTWARDS ARROW} {ends[0]} ... {ends[1]} \N{RIGHTWARDS ARROW}"


def _piece(row: int, low: float, high: float) -> Polygon:
    """Return a rectangle that is nearly as high as its row."""
    top, bottom = row - _HALF, row + _HALF
    return np.array([(low, top), (high, top), (high, bottom), (low, bottom)])


def _placed(centroids: NDArray[np.float64], extent: Extent) -> list[Polygon]:
    low, high = np.array(extent).T
    return [low + polygon * (high - low) for polygon in cells(centroids)]


def _fill(
    axes: Axes, polygons: Sequence[Polygon], values: Mapping[int, float], scale: Normalize, colours: str
) -> PolyCollection:
    """Draw every niche, pale where it is empty; return the occupied ones."""
    empty = [polygon for niche, polygon in enumerate(polygons) if niche not in values]
    axes.add_collection(PolyCollection(empty, facecolor=PALE, edgecolor=GREY, linewidth=0.3, label="empty"))
    held = sorted(values)
    chosen = [polygons[niche] for niche in held]
    filled = PolyCollection(chosen, edgecolor=GREY, linewidth=0.3, cmap=colours, norm=scale)
    filled.set_array([values[niche] for niche in held])
    axes.add_collection(filled)
    corners = np.concatenate(polygons)
    (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
    axes.set(xlim=(left, right), ylim=(low, high))
    axes.spines[:].set_visible(True)
    return filled


def _points(axes: Axes, points: Sequence[tuple[float, float]], label: str) -> None:
    """Mark where the occupants stand, visibly on light and on dark cells."""
    if points:
        marks: dict[str, Any] = {"color": BLACK, "markersize": 2.8, "linestyle": "", "clip_on": False, **OUTLINED}
        axes.plot(*zip(*points, strict=True), marker="o", label=label, zorder=_ABOVE, **marks)


def _extent(run: RecordedRun) -> Extent:
    """Return the bounds; an axis without extent, where every network stands in the middle, becomes one unit long."""
    if run.bounds is None:
        return (0.0, 1.0), (0.0, 1.0)
    ends = zip(run.bounds.low, run.bounds.high, strict=True)
    first, second = ((low, high) if high > low else (low - 0.5, low + 0.5) for low, high in ends)
    return first, second


def _clipped(point: tuple[float, ...], extent: Extent) -> tuple[float, float]:
    """Move a point into the bounds, as the archive does before it looks up its niche."""
    x, y = (min(max(value, low), high) for value, (low, high) in zip(point, extent, strict=True))
    return x, y


def _loss_scale(losses: Sequence[float]) -> Normalize:
    """Scale losses by their logarithm, so that one bad elite does not hide the differences of the others."""
    if losses and min(losses) > 0 and max(losses) > min(losses):
        return LogNorm(min(losses), max(losses))
    return Normalize()


def _legend(figure: Figure, axes: Axes, others: Iterable[Patch] = ()) -> None:
    handles, _ = axes.get_legend_handles_labels()
    figure.legend(handles=[*handles, *others], loc="outside upper center", ncols=3)
