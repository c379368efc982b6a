"""Draw what was found, one picture a question, from the published runs alone, and write all its figures as a table.

    python docs/found/draw.py build/paper/found        # as `make paper` does
    python docs/found/draw.py docs/found               # the pictures and figures.csv of these pages

benchmarks/found computes the figures. Nearly every one is a ratio of losses with its interval, so that pictures can be
compared: left of the line the first of the two, or the network beside the baseline, has the lower loss.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from analysis.figures.style import BLACK, BLUE, GREY, PAGE, VERMILLION, house_style, new_figure, render
from analysis.sweeps.pairs import LEAST
from benchmarks.found.estimates import Estimate
from benchmarks.found.pages import DRAWN, table
from benchmarks.found.records import LONG, SHORT, pooled, winners

#: Inches of a row, of what is above and below all rows, and of each further line below them.
ROW, FRAME, LINE = 0.215, 0.7, 0.14

#: Points that a letter of a column of numbers needs.
_WIDTH = 5.2

#: Where the axis of ratios may have ticks: few over a wide range, more over a narrow one.
TICKS = (
    (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0),
    (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 2.0),
)

#: What a hollow point says, below a picture that has one.
HOLLOW = f"hollow: not clear of the line, or fewer than {LEAST} values"


class Line(NamedTuple):
    """The line of no difference."""

    at: float
    name: str


BASELINE, EQUAL = Line(1, "baseline = 1"), Line(1, "no difference = 1")

#: How a ratio of losses is read, of two things and beside the baseline.
OF_TWO = "first loss / second loss: left of the line the first one is better"
OF_BASELINE = "test loss / baseline's: left of the line better than the baseline"


@house_style(PAGE)
def forest(
    rows: Sequence[Estimate], label: str, *, line: Line = BASELINE, head: str = "ratio [95 %]", beside: str = ""
) -> Figure:
    """Draw estimates with their intervals, one a row, below the headings of their groups.

    A point is filled where its interval is clear of the line and is of six values at least. The axis of ratios is
    logarithmic. Right of a row stand its numbers, of how many values they are, and what is beside them.
    """
    groups = [row.group for row in rows]
    places, headings = _places(groups)
    clear = [row.count >= LEAST and not _holds(row, line.at) for row in rows]
    figure, axes = _frame(places[-1] + 1, label if all(clear) else f"{label}\n{HOLLOW}")
    for place, row, is_clear in zip(places, rows, clear, strict=True):
        low, high = row.ends or (row.value, row.value)
        axes.plot([low, high], [place, place], color=BLUE, solid_capstyle="butt")
        axes.plot(row.value, place, "o", color=BLUE, markerfacecolor=BLUE if is_clear else "white", markersize=5)
    if line.at:
        ends = [end for row in rows for end in row.ends or ()]
        _ratios(axes, min(*ends, line.at), max(*ends, line.at))
    _reference(axes, line)
    _rows(axes, dict(zip(places, (row.of for row in rows), strict=True)), headings)
    columns = {head: [str(row) for row in rows], "n": [f"{row.count} {row.unit}" for row in rows]}
    if beside:
        columns[beside] = [row.beside for row in rows]
    _columns(axes, places, columns)
    return figure


def _holds(row: Estimate, value: float) -> bool:
    """Return whether the interval of a row holds a value."""
    low, high = row.ends or (row.value, row.value)
    return low <= value <= high


def _places(groups: Sequence[str]) -> tuple[list[int], dict[int, str]]:
    """Return the place of each row from above, and of each heading: a row before the first one of its group."""
    places: list[int] = []
    headings: dict[int, str] = {}
    group, place = "", 0
    for own in groups:
        if own != group:
            group = own
            headings[place] = own
            place += 1
        places.append(place)
        place += 1
    return places, headings


def _frame(rows: int, label: str) -> tuple[Figure, Axes]:
    """Begin a picture of so many rows."""
    figure, (axes,) = new_figure("double", FRAME + ROW * rows + LINE * label.count("\n"))
    axes.set(ylim=(rows - 0.5, -0.6), xlabel=label)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#DDDDDD")
    axes.set_axisbelow(True)
    return figure, axes


def _ratios(axes: Axes, low: float, high: float) -> None:
    """Make the axis of x one of ratios, wide enough that no line of its own lies on the frame."""
    axes.set(xscale="log", xlim=(low / 1.06, high * 1.06))
    few, many = ([tick for tick in ticks if low / 1.06 <= tick <= high * 1.06] for ticks in TICKS)
    axes.set_xticks(few if len(few) > 3 else many)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_minor_locator(NullLocator())


def _reference(axes: Axes, line: Line) -> None:
    """Draw the line of no difference, with its name above it, left of it where it is far right."""
    axes.axvline(line.at, color=BLACK, linewidth=0.8, zorder=0)
    across = axes.transAxes.inverted().transform(axes.transData.transform((line.at, 0)))[0]
    side = "right" if across > 0.7 else "center"
    axes.annotate(line.name, (line.at, -1), ha=side, va="center", annotation_clip=False)


def _rows(axes: Axes, names: dict[int, str], headings: dict[int, str]) -> None:
    """Name the rows, and write the headings at the left edge of the axis, where no row has a point."""
    axes.set_yticks([*names], [*names.values()])
    for place, heading in headings.items():
        axes.annotate(
            heading, (0, place), xycoords=axes.get_yaxis_transform(), xytext=(4, 0), textcoords="offset points",
            va="center", weight="bold", annotation_clip=False,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )  # fmt: skip


def _columns(axes: Axes, places: Sequence[int], columns: Mapping[str, Sequence[str]]) -> None:
    """Write columns of text right of the axis, each below its name."""
    left = 8.0
    for name, texts in columns.items():
        for place, text in [(-1.0, name), *zip(places, texts, strict=True)]:
            axes.annotate(
                text, (1, place), xycoords=axes.get_yaxis_transform(), xytext=(left, 0), textcoords="offset points",
                va="center", color=GREY if place < 0 else BLACK, annotation_clip=False,
            )  # fmt: skip
        left += _WIDTH * max(map(len, (name, *texts))) + 6


def summary() -> Figure:
    """Draw what was found, a row or two a question."""
    return forest([*DRAWN["summary"]()], OF_TWO, line=EQUAL)


@house_style(PAGE)
def records() -> Figure:
    """Draw what is left of a record with other training seeds, a row a search."""
    groups = [sorted((one for one in winners() if one.group == group), key=lambda one: one.with_other_seeds)
              for group in (SHORT, LONG)]  # fmt: skip
    of_all = pooled()
    short, long = groups
    places, headings = _places([*(one.group for one in short), SHORT, *(one.group for one in long)])
    figure, axes = _frame(places[-1] + 1, "best network's validation loss / baseline's: left is better")
    of_mean, of_searches = places[len(short)], places[: len(short)] + places[len(short) + 1 :]
    for place, one in zip(of_searches, (*short, *long), strict=True):
        marker = "o" if one.group == SHORT else "s"
        axes.plot([one.on_record, one.with_other_seeds], [place, place], color=GREY, zorder=1)
        axes.plot(one.on_record, place, marker, color=BLUE, markerfacecolor="white", markersize=4.5)
        axes.plot(one.with_other_seeds, place, marker, color=BLUE, markersize=4.5)
    assert of_all.ends is not None
    axes.plot(of_all.ends, [of_mean, of_mean], color=BLACK, solid_capstyle="butt")
    axes.plot(of_all.value, of_mean, "D", color=BLACK, markersize=4.5)
    _ratios(axes, min(one.on_record for one in winners()), 1)
    _reference(axes, BASELINE)
    named = {place: one.search for place, one in zip(of_searches, (*short, *long), strict=True)}
    _rows(axes, named | {of_mean: "mean of all 16 [95 %]"}, headings)
    texts = {place: (f"{one.on_record:.2f}", f"{one.with_other_seeds:.2f}")
             for place, one in zip(of_searches, (*short, *long), strict=True)}  # fmt: skip
    texts[of_mean] = ("", str(of_all))
    on_record, again = zip(*texts.values(), strict=True)
    _columns(axes, [*texts], {"on record": on_record, "other seeds": again})
    axes.plot([], [], "o", color=BLUE, markerfacecolor="white", label="on record: one training")
    axes.plot([], [], "o", color=BLUE, label="median of 2 other seeds")
    axes.plot([], [], "s", color=BLUE, label="of 20")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def ends() -> Figure:
    """Draw test losses beside the baseline's, after six epochs and after training to the end."""
    return forest([*DRAWN["ends"]()], OF_BASELINE)


@house_style(PAGE)
def model_or_grammar() -> Figure:
    """Draw what a quarter of the proposals of each search reach: a point a search."""
    arms: dict[str, list[float]] = {}
    for row in DRAWN["model_or_grammar"]():
        arms.setdefault(row.group, []).append(row.value)
    figure, axes = _frame(len(arms), "loss that a quarter of the proposals reach: left is better; a point a search")
    for place, (values, colour) in enumerate(zip(arms.values(), (BLUE, VERMILLION), strict=True)):
        axes.plot(values, [place] * len(values), "o", color=colour, markersize=5)
    axes.set(xlim=(0.19, 0.46), xticks=np.arange(0.2, 0.46, 0.05))
    _rows(axes, dict(enumerate(arms)), {})
    texts = [", ".join(f"{value:.3f}" for value in sorted(values)) for values in arms.values()]
    _columns(axes, range(len(arms)), {"three searches each": texts})
    return figure


def ablation() -> Figure:
    """Draw the arms of the ablation against the method as published."""
    label = (
        "loss that a quarter of the proposals reach / the method's, by seed:\nleft of the line better than the method"
    )
    line = Line(1, "the method (none) = 1")
    return forest([*DRAWN["ablation"]()], label, line=line, beside="p, Holm")


def paper_networks() -> Figure:
    """Draw the test losses of the paper's networks, rebuilt."""
    return forest([*DRAWN["paper_networks"]()], OF_BASELINE, beside="verdict, Holm")


def telling() -> Figure:
    """Draw what telling losses changes."""
    label = "loss of the answers / of those that were told nothing:\nleft of the line telling is better"
    return forest([*DRAWN["telling"]()], label, line=Line(1, "told nothing = 1"))


def operator() -> Figure:
    """Draw how good parents and children are beside others, and beside each other."""
    return forest([*DRAWN["operator"]()], OF_TWO, line=EQUAL)


def by_hand() -> Figure:
    """Draw the test losses of two edits by hand on three sets of images."""
    return forest([*DRAWN["by_hand"]()], OF_BASELINE)


def words() -> Figure:
    """Draw how much farther two answers to one question lie apart, by the sentence that carries the temperature."""
    rows = [*DRAWN["words"]()]
    label = "distance of two answers, less that with the first sentence:\nright of the line they are more diverse"
    line = Line(0, "change one thing = 0")
    return forest(rows, label, line=line, head="difference [95 %]", beside="p, Holm")


#: The pictures, by the names of their files.
PICTURES: dict[str, Callable[[], Figure]] = {
    "summary": summary,
    "records": records,
    "ends": ends,
    "model_or_grammar": model_or_grammar,
    "ablation": ablation,
    "paper_networks": paper_networks,
    "telling": telling,
    "operator": operator,
    "by_hand": by_hand,
    "words": words,
}


def main(place: str) -> None:
    """Write all pictures and the table into a directory."""
    folder = Path(place)
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in PICTURES.items():
        (folder / f"{name}.svg").write_bytes(render(draw(), ".svg"))
    (folder / "figures.csv").write_bytes(table())
    print(f"written: {folder} ({len(PICTURES)} pictures, figures.csv)")


if __name__ == "__main__":
    main(sys.argv[1])
