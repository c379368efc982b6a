"""Draw what a replay checks, what `--retrain` checks, and what nothing here can show.

python docs/site/checked.py docs/figures/checked.svg
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, house_style, new_figure, render

#: What is recorded: its title, what it is, which command checks it, and in which colour.
COLUMNS = (
    ("answers", "what the model\nwrote", "taken as recorded:\nnothing can show that\na model gave them", GREY),
    (
        "trainings",
        "losses and weights\nof each candidate",
        "tacevo replay\n--retrain 5:\ntrained again, same bits",
        ORANGE,
    ),
    (
        "decisions",
        "gate, niches, parents,\nboth archives",
        "tacevo replay:\ncomputed again from\nanswers and trainings",
        BLUE,
    ),
    ("scores", "tests, p values,\nverdicts", "tacevo replay:\ncomputed again from\nthe predictions", BLUE),
    ("pages", "figures, texts,\nolder tables", "the bundle digest:\ncompare it with the\none that is cited", GREEN),
)

_WIDTH, _STEP = 1.3, 1.46


@house_style()
def checked() -> Figure:
    """Draw a column for each kind of record: what it is above, what speaks for it below."""
    figure, (axes,) = new_figure("double", 2.2)
    axes.set(xlim=(-0.05, len(COLUMNS) * _STEP - 0.1), ylim=(-0.05, 2.5))
    axes.axis("off")
    for place, (title, what, check, colour) in enumerate(COLUMNS):
        left, middle = place * _STEP, place * _STEP + _WIDTH / 2
        axes.add_patch(_box(left, 1.5, 0.95, BLACK))
        axes.text(middle, 2.25, title, ha="center", va="center", weight="bold")
        axes.text(middle, 1.84, what, ha="center", va="center")
        axes.add_patch(_box(left, 0.0, 1.05, colour))
        axes.text(middle, 0.52, check, ha="center", va="center")
        arrow = FancyArrowPatch((middle, 1.05), (middle, 1.5), arrowstyle="-|>", mutation_scale=8, color=GREY, lw=1)
        axes.add_patch(arrow)
    return figure


def _box(left: float, bottom: float, height: float, colour: str) -> FancyBboxPatch:
    return FancyBboxPatch(
        (left, bottom), _WIDTH, height, boxstyle="round,pad=0,rounding_size=0.08", fc="white", ec=colour, lw=1.2
    )


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(checked(), ".svg"))
