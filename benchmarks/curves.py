"""Draw what `benchmarks.difficulty` measured: losses over epochs, and ten-epoch fitness against the test score.

python -m benchmarks.curves benchmarks/results/*-*.json --out docs/figures/difficulty.svg
"""

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.difficulty import SHORT, headline

#: Okabe and Ito's colours, which colour-blind readers can distinguish.
COLOURS = {"force": "#0072B2", "grating": "#D55E00", "hardness": "#009E73"}
DASHES = {48: ":", 64: "--", 128: "-.", 256: "-"}

Result = dict[str, Any]


def draw(results: list[Result]) -> Figure:
    """Draw both panels, at the width of two columns of a paper."""
    figure = Figure(figsize=(7.16, 2.8), layout="constrained")
    learning, ranking = figure.subplots(1, 2)
    _learning(learning, [result for result in results if result["network"] == 0 and result["seed"] == 0])
    _ranking(ranking, results)
    return figure


def _learning(axes: Axes, baselines: list[Result]) -> None:
    """Validation loss of the baseline, one line a task and image size."""
    for result in sorted(baselines, key=lambda result: (result["task"], result["size"])):
        losses = result["losses"]
        task, size = result["task"], result["size"]
        epochs = range(1, len(losses) + 1)
        axes.plot(epochs, losses, color=COLOURS[task], linestyle=DASHES[size], linewidth=1, label=f"{task}, {size} px")
    axes.axvline(SHORT, color="0.7", linewidth=0.8, zorder=0)
    axes.set(xlabel="epoch", ylabel="validation loss of the baseline", yscale="log")
    axes.legend(fontsize=7, frameon=False)


def _ranking(axes: Axes, results: list[Result]) -> None:
    """One dot a network, of the studies with many networks."""
    studies = sorted({(result["task"], result["size"]) for result in results if result["network"] > 0})
    for task, size in studies:
        study = [result for result in results if (result["task"], result["size"], result["seed"]) == (task, size, 0)]
        fitness = [result["losses"][SHORT - 1] for result in study]
        scores = [max(headline(result), 0) for result in study]  # a network that never learnt would hide the others
        axes.scatter(fitness, scores, s=12, color=COLOURS[task], label=f"{task}, {size} px")
        axes.scatter(fitness[:1], scores[:1], s=40, facecolors="none", edgecolors="black", linewidths=0.8)
    axes.set(xlabel=f"validation loss at epoch {SHORT}", ylabel="test score, fully trained (at least 0)", xscale="log")
    axes.legend(fontsize=7, frameon=False, title="circles: the baseline", title_fontsize=7, loc="lower left")


def main() -> None:
    """Read results, and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    options = parser.parse_args()
    results = [result for file in options.files for result in json.loads(file.read_text())]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"font.size": 8, "svg.hashsalt": "tacevo", "svg.fonttype": "none"}):
        draw(results).savefig(options.out, metadata={"Date": None} if options.out.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
