"""Draw the pictures of pages that show what was measured and recorded.

python docs/site/pictures.py docs/figures
"""

import json
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

from matplotlib.figure import Figure

import tacevo
from analysis.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, YELLOW, house_style, new_figure, render
from benchmarks import fidelity

ROOT = Path(__file__).parents[2]

#: What is done; the title of its figures in the results of `make bench`, and how the name of each begins.
MEASURED = (
    ("a search,\nbeside openevolve", "processor time of a search of 41 candidates", "numerics="),
    ("training, 32 px,\nbeside a bare loop", "training at 32 px", "confined, "),
    ("training, 64 px,\nbeside a bare loop", "training at 64 px", "confined, "),
    ("training, 128 px,\nbeside a bare loop", "training at 128 px", "confined, "),
)

#: The numerics, what each promises, and its colour.
NUMERICS = (
    ("portable", "equal bits on every CPU with AVX2", GREEN),
    ("portable512", "equal bits on every CPU with AVX-512", SKY),
    ("fast", "equal bits on this machine", YELLOW),
)

#: The groups of networks of `benchmarks.fidelity`, in words.
MEANT = {
    "first mutations": "40 first mutations: nobody had chosen them",
    "elites": "79 elites: ten epochs had chosen them",
}

#: Figures of published files, by the names that `tacevo figures` and `tacevo ablations` give them.
PUBLISHED = {
    "grating-claude": ("fitness", "archive_growth", "network_map", "prompt_productivity", "seed_boxes", "forest"),
    "ablation-proposals": ("ablation_forest", "ablation_curves"),
}


@house_style()
def speed() -> Figure:
    """Draw a bar for each ratio of the last measurement (benchmarks/README.md), which stands at its end."""
    results = json.loads((ROOT / "benchmarks/results/bench.json").read_text())
    ratios = {(row["title"], row["name"]): row["ratio"] for row in results["figures"]}
    figure, (axes,) = new_figure("double", 2.9)
    for place, (_, title, start) in enumerate(MEASURED):
        for number, (name, promise, colour) in enumerate(NUMERICS):
            ratio, height = ratios[title, f"{start}{name}"], place + 0.26 * (number - 1)
            label = f"{name}: {promise}" if place == 0 else None
            axes.barh(height, ratio, height=0.24, color=colour, edgecolor=BLACK, lw=0.5, label=label)
            axes.text(ratio - 0.01, height, f"{ratio:.2f}", ha="right", va="center")
    axes.axvline(1, color=GREY, lw=1)
    axes.text(1.01, -0.45, "the peer", color=GREY, va="center")
    axes.set(
        xlim=(0, 1.12),
        ylim=(len(MEASURED) - 0.5, -0.7),
        yticks=range(len(MEASURED)),
        yticklabels=[row[0] for row in MEASURED],
    )
    axes.set_xlabel("processor time of the peer / ours (more is faster)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.45, -0.25), fontsize=7)
    return figure


@house_style()
def luck() -> Figure:
    """Draw the demo's networks, a row each: every training with another seed, their median, and what is on record."""
    run = tacevo.open(ROOT / "tests/golden/demo.zip")
    assert isinstance(run, tacevo.Run)
    frame = run.studies[0].reestimates
    figure, (axes,) = new_figure("double", 1.9)
    networks = list(frame.groupby(["network", "id"], sort=False))
    for place, (_, own) in enumerate(networks):
        recorded, again, is_first = own["recorded"].iloc[0], own["fitness"], place == 0
        seeds, middle, record = ("another seed", "their median", "on record") if is_first else (None, None, None)
        axes.plot(again, [place] * len(again), "o", mfc="none", mec=BLUE, ms=4, label=seeds)
        axes.plot(again.median(), place, "|", color=BLACK, ms=14, mew=2, label=middle)
        axes.plot(recorded, place, "*", color=ORANGE, ms=10, mec=BLACK, mew=0.5, label=record)
        axes.text(again.median(), place - 0.24, f"{again.median():.3f}", ha="center", va="bottom")
        axes.text(recorded, place + 0.24, f"{recorded:.3f}", ha="center", va="top", color=GREY)
    names = [network if network == "baseline" else f"{candidate} ({network})" for (network, candidate), _ in networks]
    axes.set(ylim=(len(names) - 0.4, -0.75), xlim=(0.2, 1.2), xlabel="validation loss (less is better)")
    axes.set(yticks=range(len(names)), yticklabels=names)
    axes.legend(loc="upper left", ncols=3, bbox_to_anchor=(0, 1.22))
    return figure


@house_style()
def ranking() -> Figure:
    """Draw how well the fitness after each number of epochs ranks final test losses, among two groups of networks."""
    figure, (axes,) = new_figure("double", 2.6)
    for (name, place), colour, shift in zip(fidelity.GROUPS.items(), (BLUE, ORANGE), (0.97, 1.03), strict=True):
        tau, low, high = (
            part[:, 0] for part in fidelity.with_interval(fidelity.blocks_of(str(ROOT / place)), fidelity.taus)
        )
        epochs = [shift * epoch for epoch in fidelity.EPOCHS]
        bars = (tau - low, high - tau)
        axes.errorbar(epochs, tau, bars, fmt="o-", color=colour, ms=4, lw=1, elinewidth=0.7, label=MEANT[name])
    axes.axhline(0, color=GREY, lw=0.8)
    axes.set(xscale="log", xticks=fidelity.EPOCHS, xticklabels=fidelity.EPOCHS, ylim=(-0.15, 0.65))
    axes.minorticks_off()
    axes.set(
        xlabel="epochs of the fitness (the lowest loss so far)",
        ylabel="Kendall's tau with the final\ntest loss of the other seed",
    )
    axes.legend(loc="upper left")
    return figure


#: Each file is opened once.
opened = cache(tacevo.open)


def published(bundle: str, name: str) -> Figure:
    """Draw a figure of a published file."""
    return opened(ROOT / f"cache/published/{bundle}.zip").figures[name]()


PICTURES: dict[str, Callable[[], Figure]] = {
    "speed": speed,
    "luck": luck,
    "ranking": ranking,
    **{name: partial(published, bundle, name) for bundle, names in PUBLISHED.items() for name in names},
}


def main(folder: str) -> None:
    """Draw all of them into a directory."""
    for name, picture in PICTURES.items():
        (Path(folder) / f"{name}.svg").write_bytes(render(picture(), ".svg"))


if __name__ == "__main__":
    main(sys.argv[1])
