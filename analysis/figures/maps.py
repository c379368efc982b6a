"""Maps of both archives: every niche as its Voronoi cell, in the units of the axes, coloured by what holds it."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from analysis.figures.axes import title_unsent_temperatures
from analysis.figures.style import BLACK, COLOUR_MAP, DARKEST, GREY, PALE, SHADE, VERMILLION, house_style, new_figure
from analysis.runs.coverage_map import axis_label
from analysis.runs.niches import Polygon, cells
from tacevo.results.run import RecordedRun, descriptors_of

#: (low, high) of both axes, in their units.
Extent = tuple[tuple[float, float], tuple[float, float]]

#: In inches.
HEIGHT = 3.1

_OUTLINED: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5}


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
    _points(axes, [place for name, place in places.items() if name not in moved])
    if run.elites:
        best = places[run.ranked()[0].id]
        axes.plot(*best, "*", color=VERMILLION, markersize=8, label="best", clip_on=False, **_OUTLINED)
        bar = figure.colorbar(filled, label="validation loss of the elite", pad=0.02)
        if isinstance(filled.norm, LogNorm):
            bar.set_label("validation loss of the elite (logarithmic scale)")
            bar.ax.yaxis.set_major_locator(FixedLocator(list(np.geomspace(*filled.get_clim(), 5))))
            bar.ax.yaxis.set_minor_locator(NullLocator())
            bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    if moved:
        outside = [places[name] for name in sorted(moved)]
        marks: dict[str, Any] = {"color": BLACK, "markersize": 4.5, "clip_on": False, "zorder": 4, **_OUTLINED}
        axes.plot(*zip(*outside, strict=True), "X", label="outside the bounds", **marks)
    across, up = (axis_label(axis, scale, r"$\log_{10}$") for axis in run.config.archive.axes)
    axes.set(xlabel=across, ylabel=up)
    _legend(figure, axes)
    return figure


@house_style()
def prompt_map(run: RecordedRun, centroids: NDArray[np.float64], reachable: Collection[int]) -> Figure:
    """Draw the prompt archive over instruction and temperature, each niche in the colour of its trial's curiosity.

    A trial whose child the network archive did not take is hatched; a niche that the run could not reach is shaded; a
    title says where temperatures were not sent. The centroids are those of the prompt archive, shape (niches, 2), in
    [0, 1]; `reachable` are the niches that a trial of the run could have.
    """
    figure, (axes,) = new_figure("single", HEIGHT)
    curiosity = {trial.niche: trial.curiosity for trial in run.prompt_trials}
    polygons = _placed(centroids, ((0.0, float(max(len(run.instructions) - 1, 1))), (0.0, 1.0)))
    filled = _fill(axes, polygons, curiosity, Normalize(0.5, 2.0), COLOUR_MAP)
    legend: list[Patch] = []
    beyond = [polygon for niche, polygon in enumerate(polygons) if niche not in reachable]
    if beyond:
        shade: dict[str, Any] = {"facecolor": SHADE, "edgecolor": GREY, "linewidth": 0.3, "hatch": "...."}
        axes.add_collection(PolyCollection(beyond, **shade))
        legend.append(Patch(**shade, label="out of reach"))
    fruitless = [trial.niche for trial in run.prompt_trials if not trial.inserted]
    if fruitless:
        marks: dict[str, Any] = {"facecolor": "none", "edgecolor": "white", "linewidth": 0.3, "hatch": "/////"}
        axes.add_collection(PolyCollection([polygons[niche] for niche in fruitless], **marks))
        legend.append(Patch(**{**marks, "facecolor": DARKEST}, label="child not inserted"))
    _points(axes, [(trial.prompt, trial.temperature) for trial in run.prompt_trials])
    if run.prompt_trials:
        figure.colorbar(filled, label="curiosity of the trial", pad=0.02, ticks=[0.5, 1.0, 1.5, 2.0])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="instruction (index in the library)", ylabel=f"temperature $T_g${run.carried}")
    title_unsent_temperatures(axes, run)
    _legend(figure, axes, legend)
    return figure


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


def _points(axes: Axes, points: Iterable[tuple[float, float]]) -> None:
    """Mark where the occupants stand, visibly on light and on dark cells."""
    for point in points:
        axes.plot(*point, "o", color=BLACK, markersize=2.4, clip_on=False, **_OUTLINED)


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
