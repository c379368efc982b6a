"""Draw how a search works: what is done with a candidate, and the file in which it is recorded.

python docs/site/loop.py docs/figures/loop.svg
"""

import sys
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PAGE, house_style, new_figure, render

#: The steps of a candidate: what is done, in few words, and where it is recorded.
STEPS = (
    ("model", "rewrites the code\nof one or two parents", "cache/completions", ORANGE),
    ("gate", "reads the code and\nmeasures the network", "cache/answers\ncache/probes", BLUE),
    ("sandbox", "trains it briefly,\nand sees no test label", "cache/evaluations", BLUE),
    ("archive", "keeps the best\nof each kind", "ledger.jsonl", GREEN),
)

#: What comes after the search, from right to left.
AFTER = (
    ("study", "trains the best fully,\nwith several seeds", "scores.jsonl", BLUE),
    ("verdict", "tests these against\nthe baseline", "tables/", GREEN),
    ("bundle", "is one file with\nall these files", "NAME.zip", GREEN),
    ("anybody", "computes decisions\nand scores again", "tacevo replay", ORANGE),
)

_WIDTH, _HEIGHT, _STEP = 1.56, 1.06, 1.78

#: Points of the names of files, which are wider than words.
_FILES = 7.8


@house_style(PAGE)
def loop() -> Figure:
    """Draw the loop of a search, and the study after it, to the replay by somebody else."""
    figure, (axes,) = new_figure("double", 2.9)
    axes.set(xlim=(-0.05, 3 * _STEP + _WIDTH + 0.05), ylim=(-0.05, 3.35))
    axes.axis("off")
    above = 1.45
    for place, step in enumerate(STEPS):
        _box(axes, (place * _STEP, above), step)
        if place:
            _arrow(axes, ((place - 1) * _STEP + _WIDTH, above + 0.5), (place * _STEP, above + 0.5))
    for place, step in enumerate(AFTER):
        _box(axes, ((3 - place) * _STEP, 0.0), step)
        if place:
            _arrow(axes, ((4 - place) * _STEP, 0.5), ((3 - place) * _STEP + _WIDTH, 0.5))
    last = 3 * _STEP + _WIDTH / 2
    _arrow(axes, (last, above), (last, _HEIGHT))
    bent = "arc,angleA=90,angleB=90,armA=34,armB=34,rad=8"
    _arrow(axes, (last, above + _HEIGHT), (_WIDTH / 2, above + _HEIGHT), bent)
    text = "parents of the next generation"
    axes.text(1.5 * _STEP + _WIDTH / 2, 2.98, text, ha="center", va="center", color=GREY)
    return figure


def _box(axes: Axes, corner: tuple[float, float], step: tuple[str, str, str, str]) -> None:
    (left, bottom), (title, text, file, colour) = corner, step
    shape = FancyBboxPatch(
        (left, bottom), _WIDTH, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.08", fc="white", ec=colour, lw=1.2
    )
    axes.add_patch(shape)
    middle = left + _WIDTH / 2
    rows: tuple[tuple[float, str, dict[str, Any]], ...] = (
        (0.93, title, {"weight": "bold", "color": BLACK}),
        (0.6, text, {"color": BLACK}),
        (0.19, file, {"color": GREY, "size": _FILES, "family": "DejaVu Sans Mono"}),
    )
    for height, words, how in rows:
        axes.text(middle, bottom + height, words, ha="center", va="center", **how)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], bent: str = "arc3") -> None:
    axes.add_patch(
        FancyArrowPatch(
            start, end, connectionstyle=bent, arrowstyle="-|>", mutation_scale=8, color=GREY, lw=1, clip_on=False
        )
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(loop(), ".svg"))
