"""Draw how much of the processor's work a peer needs for the same, from the last measurement (benchmarks/README.md).

python docs/site/speed.py docs/figures/speed.svg
"""

import json
import sys
from pathlib import Path

from matplotlib.figure import Figure

from analysis.figures.style import BLACK, GREEN, GREY, SKY, YELLOW, house_style, new_figure, render

RESULTS = Path(__file__).parents[2] / "benchmarks/results/bench.json"

#: What is done; the title of its figures, and how the name of each begins.
ROWS = (
    ("a search,\nbeside openevolve", "processor time of a search of 41 candidates", "numerics="),
    ("training, 64 px,\nbeside a bare loop", "training at 64 px", "confined, "),
    ("training, 128 px,\nbeside a bare loop", "training at 128 px", "confined, "),
)

#: The numerics, what each promises, and its colour.
NUMERICS = (
    ("portable", "equal bits on every CPU with AVX2", GREEN),
    ("portable512", "equal bits on every CPU with AVX-512", SKY),
    ("fast", "equal bits on this machine", YELLOW),
)


@house_style()
def speed() -> Figure:
    """Draw a bar for each ratio, which stands at its end."""
    ratios = {(row["title"], row["name"]): row["ratio"] for row in json.loads(RESULTS.read_text())["figures"]}
    figure, (axes,) = new_figure("double", 2.4)
    for place, (_, title, start) in enumerate(ROWS):
        for number, (name, promise, colour) in enumerate(NUMERICS):
            ratio, height = ratios[title, f"{start}{name}"], place + 0.26 * (number - 1)
            label = f"{name}: {promise}" if place == 0 else None
            axes.barh(height, ratio, height=0.24, color=colour, edgecolor=BLACK, lw=0.5, label=label)
            axes.text(ratio - 0.01, height, f"{ratio:.2f}", ha="right", va="center")
    axes.axvline(1, color=GREY, lw=1)
    axes.text(1.01, -0.52, "the peer", color=GREY, va="center")
    axes.set(xlim=(0, 1.12), ylim=(2.5, -0.6), yticks=range(len(ROWS)), yticklabels=[row[0] for row in ROWS])
    axes.set_xlabel("speed beside the peer, which is 1 (more is faster)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.45, -0.25), ncols=1, fontsize=7)
    return figure


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(speed(), ".svg"))
