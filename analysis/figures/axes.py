"""Axes that several figures share."""

import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.patches import PathPatch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import Formatter, Locator, MaxNLocator, NullFormatter, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from analysis.figures.style import BLACK, GREY, PALE
from tacevo.evolution.lines import TEMPERATURE
from tacevo.results.run import RecordedRun

#: The longest line of a title over a single column, in characters.
_TITLE = 40

#: Lines that lie on each other, of which the names are written.
_NAMED = 3

#: Losses stand on a logarithmic axis where the largest is at least this many times the smallest.
LOG_FROM = 10.0

#: Half of what the seeds of one place are apart, as part of that place.
_SPREAD = 0.24

#: From this many values on, a box of quartiles lies under them; of fewer it would show what they do not.
BOXED = 6

_BOXES: dict[str, Any] = {
    "showfliers": False,
    "patch_artist": True,
    "boxprops": {"facecolor": PALE, "edgecolor": GREY},
    "whiskerprops": {"color": GREY},
    "capprops": {"color": GREY},
    "medianprops": {"color": BLACK, "linewidth": 1.4},
}


def boxes(axes: Axes, samples: Sequence[NDArray[np.float64]], places: Sequence[int], **how: Any) -> list[PathPatch]:
    """Draw a box of quartiles for each sample of `BOXED` values or more, over which every value is to stand as a point.

    Of a smaller sample only the median is drawn. `how` is as of `Axes.boxplot`.

    Returns:
        The boxes, in the order of the samples; none of a small sample.
    """
    large = [place for place, values in zip(places, samples, strict=True) if len(values) >= BOXED]
    drawn: list[PathPatch] = []
    if large:
        boxed = [values for values in samples if len(values) >= BOXED]
        drawn = list(axes.boxplot(boxed, positions=large, **{**_BOXES, **how})["boxes"])
    for place, values in zip(places, samples, strict=True):
        if 0 < len(values) < BOXED:
            across = [place - how["widths"] / 2, place + how["widths"] / 2], [float(np.median(values))] * 2
            axes.plot(
                *(reversed(across) if how.get("orientation") == "horizontal" else across), **_BOXES["medianprops"]
            )
    return drawn


def name_coinciding(axes: Axes) -> None:
    """Write above the axes which of its lines lie on each other, since only the last one is seen."""
    lines: dict[bytes, list[str]] = {}
    for line in axes.lines:
        points = np.asarray(line.get_xydata(), dtype=np.float64)
        if not str(line.get_label()).startswith("_") and np.isfinite(points).all(axis=1).any():
            lines.setdefault(points.tobytes(), []).append(str(line.get_label()))
    twins = [names for names in lines.values() if len(names) > 1]
    told = [" = ".join(names[:_NAMED]) + (" = ..." if len(names) > _NAMED else "") for names in twins]
    if told:
        axes.set_title(textwrap.fill("; ".join(told), _TITLE), parse_math=False)


def spread(place: float, count: int) -> NDArray[np.float64]:
    """Spread so many points evenly around a place, or one on it."""
    return place + (np.linspace(-_SPREAD, _SPREAD, count) if count > 1 else np.zeros(count))


def name_point(axes: Axes, name: str, point: tuple[float, float], *, is_left: bool = False) -> None:
    """Write a name beside a point, readable over lines and other points."""
    axes.annotate(
        name,
        point,
        xytext=(-4 if is_left else 4, 0),
        textcoords="offset points",
        ha="right" if is_left else "left",
        va="center",
        zorder=5,
        path_effects=[withStroke(linewidth=1.8, foreground="white")],
        parse_math=False,
    )


class RoundLogLocator(Locator):
    """Put the ticks of a logarithmic axis at round numbers.

    These are the powers of ten where three or more can be seen, else 1, 2 and 5 times these. Where not even two of
    them can be seen, they are the round numbers of a linear axis.
    """

    def __call__(self) -> Sequence[float]:
        """Return the ticks of the axis."""
        low, high = self.axis.get_view_interval() if self.axis is not None else (1.0, 10.0)
        return self.tick_values(low, high)

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Return the ticks from one value, above 0, to another one."""
        low, high = sorted((vmin, vmax))
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for digits, fewest in (((1,), 3), ((1, 2, 5), 2)):
            ticks = [float(f"{digit}e{decade}") for decade in decades for digit in digits]
            seen = [tick for tick in ticks if low <= tick <= high]
            if len(seen) >= fewest:
                return seen
        linear = MaxNLocator(nbins=4, steps=[1, 2, 5, 10]).tick_values(low, high)
        return [float(tick) for tick in linear if low <= tick <= high]


def count_along(axes: Axes, label: str, *, most: int = 9) -> None:
    """Name the level axis of whole numbers, e.g. of generations, on which all is drawn already.

    Its ticks are whole and round, and none lies beyond what is drawn.
    """
    axes.set_xlabel(label)
    ends = axes.dataLim.intervalx
    if not np.isfinite(ends).all():
        return
    first, last = math.ceil(ends[0]), math.floor(ends[1])  # bars and steps reach half a place beyond
    ticks = MaxNLocator(nbins=most, steps=[1, 2, 5, 10], integer=True, min_n_ticks=1).tick_values(first, last)
    axes.set_xticks([int(tick) for tick in ticks if first <= tick <= last and tick == int(tick)])


def logarithmic(axis: Axis, formatter: Formatter | None = None) -> None:
    """Make an axis logarithmic, with round numbers (`RoundLogLocator`), written plainly unless a formatter is given."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})  # type: ignore[attr-defined]
    axis.set_major_locator(RoundLogLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}") if formatter is None else formatter)
    axis.set_minor_formatter(NullFormatter())
    axis.set_minor_locator(NullLocator())


def on_loss_axis(axes: Axes, losses: Iterable[float | None]) -> None:
    """Name and scale the upright axis of validation losses.

    A loss of None, where nothing was trained, is not drawn.
    """
    values = [loss for loss in losses if loss is not None]
    axes.set_ylabel("validation loss")
    if values and min(values) > 0 and max(values) >= LOG_FROM * min(values):
        logarithmic(axes.yaxis)
    else:
        axes.set_ylim(bottom=0)


#: Where words beside a row of a forest plot stand, in widths of its axes.
_BESIDE = 1.03


def interval(
    axes: Axes, row: int, value: float, ends: tuple[float, float], *, colour: str, marker: str, is_filled: bool
) -> None:
    """Draw a difference and its interval into a row of a forest plot."""
    axes.plot(ends, [row, row], color=colour, solid_capstyle="butt", zorder=2)
    face = colour if is_filled else "white"
    axes.plot(value, row, marker, color=colour, markerfacecolor=face, markersize=4.5, zorder=3)


def beside(axes: Axes, row: int, words: str) -> None:
    """Write words to the right of a row of a forest plot."""
    axes.text(_BESIDE, row, words, transform=axes.get_yaxis_transform(), va="center")


def forest_axes(axes: Axes, rows: int, label: str, sides: tuple[str, str], head: str) -> None:
    """Complete a forest plot: the line of no difference, which always is in sight, and what lies at either side.

    `head` stands above what is beside its rows.
    """
    axes.axvline(0, color=BLACK, linewidth=0.8, zorder=1)
    low, high = axes.get_xlim()
    axes.set(ylim=(rows - 0.5, -0.5), xlabel=label, xlim=(low, high))
    axes.tick_params(axis="y", length=0)
    for place, side, words in (
        (0.0, "left", f"\N{LEFTWARDS ARROW} {sides[0]}"),
        (1.0, "right", f"{sides[1]} \N{RIGHTWARDS ARROW}"),
        (_BESIDE, "left", f"{head}\n"),  # a line above the sides, which it does not belong to
    ):
        axes.text(place, 1.02, words, transform=axes.transAxes, ha=side, va="bottom")
    axes.grid(axis="x", color="#DDDDDD")
    axes.set_axisbelow(True)


def title_unsent_temperatures(axes: Axes, run: RecordedRun) -> None:
    """Write above the axes of temperatures that they were not sent to the model, where that is so."""
    axes.set_title(textwrap.fill(run.not_sent.get(TEMPERATURE, ""), _TITLE))
