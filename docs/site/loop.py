"""Draw how a search works: what is done with a candidate, and the file in which it is recorded.

python docs/site/loop.py docs/figures/loop.svg
"""

import sys
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, house_style, new_figure, render

#: The steps of a candidate: what is done, in few words, and where it is recorded.
STEPS = (
    ("model", "rewrites the code\nof one or two parents", "cache/completions", ORANGE),
    ("gate", "reads the code and\nmeasures the network", "cache/probes", BLUE),
    ("sandbox", "trains it briefly,\nand sees no test label", "cache/evaluations", BLUE),
    ("archive", "keeps the best\nof each kind", "ledger.jsonl", GREEN),
)

#: What comes after the search.
AFTER = (
    ("study", "trains the best fully,\n20 seeds each", "scores.jsonl", BLUE),
    ("verdict", "tests them against\nthe baseline", "tables/", GREEN),
)

_WIDTH, _HEIGHT, _STEP = 1.42, 1.0, 1.72


@house_style()
def loop() -> Figure:
    """Draw the loop of a search, and the study after it."""
    figure, (axes,) = new_figure("double", 2.5)
    axes.set(xlim=(-0.15, 4 * _STEP - 0.1), ylim=(-0.05, 3.2))
    axes.axis("off")
    for place, step in enumerate(STEPS):
        _box(axes, (place * _STEP, 1.35), step)
        if place:
            _arrow(axes, ((place - 1) * _STEP + _WIDTH, 1.85), (place * _STEP, 1.85))
    for place, step in enumerate(AFTER):
        _box(axes, ((3 - place) * _STEP, 0.0), step)
    _arrow(axes, (3 * _STEP + _WIDTH / 2, 1.35), (3 * _STEP + _WIDTH / 2, _HEIGHT))
    _arrow(axes, (3 * _STEP, 0.5), (2 * _STEP + _WIDTH, 0.5))
    _arrow(axes, (3 * _STEP + _WIDTH / 2, 2.35), (_WIDTH / 2, 2.35), "arc,angleA=90,angleB=90,armA=40,armB=40,rad=8")
    axes.text(1.5 * _STEP + _WIDTH / 2, 2.95, "parents of the next generation", ha="center", va="center", color=GREY)
    return figure


def _box(axes: Axes, corner: tuple[float, float], step: tuple[str, str, str, str]) -> None:
    (left, bottom), (title, text, file, colour) = corner, step
    shape = FancyBboxPatch(
        (left, bottom), _WIDTH, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.08", fc="white", ec=colour, lw=1.2
    )
    axes.add_patch(shape)
    middle = left + _WIDTH / 2
    axes.text(middle, bottom + 0.84, title, ha="center", va="center", weight="bold", color=BLACK)
    axes.text(middle, bottom + 0.52, text, ha="center", va="center", color=BLACK)
    axes.text(middle, bottom + 0.16, file, ha="center", va="center", color=GREY, family="DejaVu Sans Mono")


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], bent: str = "arc3") -> None:
    axes.add_patch(
        FancyArrowPatch(
            start, end, connectionstyle=bent, arrowstyle="-|>", mutation_scale=8, color=GREY, lw=1, clip_on=False
        )
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(loop(), ".svg"))
