"""Draw what a baseline learns, from what `make answered NAME=difficulty` measured (benchmarks/results).

python docs/site/difficulty.py docs/figures/difficulty.svg
"""

import json
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from analysis.figures.style import BLACK, BLUE, GREEN, GREY, PAGE, VERMILLION, house_style, new_figure, render

RESULTS = Path(__file__).parents[2] / "benchmarks/results"

COLOURS = {"force": BLUE, "grating": VERMILLION, "hardness": GREEN}

#: How the line of each size of image is dashed.
DASHES = {48: ":", 64: "--", 128: "-.", 256: "-"}

#: The epochs after which a search of the paper takes the fitness.
SHORT = 10


def results(task: str, size: int) -> list[dict[str, Any]]:
    """Read the trainings of a task at a size of images."""
    return json.loads((RESULTS / f"{task}-{size}.json").read_text(encoding="utf-8"))  # type: ignore[no-any-return]


@house_style(PAGE)
def difficulty() -> Figure:
    """Draw losses of the baseline over epochs, and the fitness of networks beside their test scores."""
    figure, (curves, ranks) = new_figure("double", 3.6, columns=2)
    for task, colour in COLOURS.items():
        for size, dash in DASHES.items():
            if (RESULTS / f"{task}-{size}.json").is_file():
                losses = results(task, size)[0]["losses"]
                curves.plot(range(1, len(losses) + 1), losses, dash, color=colour, label=f"{task}, {size} px")
    curves.axvline(SHORT, color=GREY, linewidth=0.8)
    curves.annotate(
        f"epoch {SHORT}: the paper's fitness",
        (SHORT, 1),
        xycoords=curves.get_xaxis_transform(),
        ha="center",
        va="bottom",
    )
    curves.set(yscale="log", xlabel="epoch", ylabel="validation loss (low is better)")
    figure.legend(*curves.get_legend_handles_labels(), loc="outside lower center", ncols=4, columnspacing=1)
    for task, score in {"force": "R2 of three axes (0 or more)", "grating": "accuracy"}.items():
        for one in results(task, 48):
            if one["seed"] == 0:
                is_baseline = one["network"] == 0
                place = one["losses"][SHORT - 1], _score(one["test"])
                name = f"{task}: {score}" if is_baseline else None
                ranks.plot(*place, "o", color=COLOURS[task], markersize=4, label=name)
                if is_baseline:
                    ranks.plot(*place, "o", color=BLACK, markerfacecolor="none", markersize=7)
    ranks.plot([], [], "o", color=BLACK, markerfacecolor="none", markersize=7, label="circle: the baseline")
    ranks.set(xscale="log", xlabel=f"validation loss at epoch {SHORT}", ylabel="test score, fully trained (1 is best)")
    ranks.legend(loc="lower left")
    return figure


def _score(tested: dict[str, Any]) -> float:
    """Return the accuracy, or the mean R2 of the axes, which is shown as 0 where it is less."""
    return float(tested["accuracy"] if "accuracy" in tested else max(0, sum(tested["r2"]) / len(tested["r2"])))


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(difficulty(), ".svg"))
