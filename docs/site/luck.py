"""Draw why a record is partly luck: the demo's best networks, trained again with seeds that its search did not use.

python docs/site/luck.py docs/figures/luck.svg
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import tacevo
from analysis.figures.style import BLACK, BLUE, GREY, ORANGE, house_style, new_figure, render

#: The run of `make demo` and its noise run, as they are recorded.
DEMO = Path(__file__).parents[2] / "tests/golden/demo.zip"


@house_style()
def luck() -> Figure:
    """Draw a row a network: every training, their median, and what the search recorded."""
    run = tacevo.open(DEMO)
    assert isinstance(run, tacevo.Run)
    frame = run.studies[0].reestimates
    figure, (axes,) = new_figure("double", 1.9)
    names = list(dict.fromkeys(zip(frame["network"], frame["id"], strict=True)))
    for place, (network, _) in enumerate(names):
        own = frame[frame["network"] == network]
        recorded, again = own["recorded"].iloc[0], own["fitness"]
        first = place == 0
        axes.plot(again, [place] * len(again), "o", mfc="none", mec=BLUE, ms=4, label="another seed" if first else None)
        axes.plot(again.median(), place, "|", color=BLACK, ms=14, mew=2, label="their median" if first else None)
        axes.plot(recorded, place, "*", color=ORANGE, ms=10, mec=BLACK, mew=0.5, label="on record" if first else None)
        axes.text(again.median(), place - 0.24, f"{again.median():.3f}", ha="center", va="bottom")
        axes.text(recorded, place + 0.24, f"{recorded:.3f}", ha="center", va="top", color=GREY)
    axes.set(ylim=(len(names) - 0.4, -0.75), xlim=(0.2, 1.2), xlabel="validation loss (less is better)")
    axes.set(
        yticks=range(len(names)), yticklabels=[name if name == "baseline" else f"{name} ({own})" for name, own in names]
    )
    axes.legend(loc="upper left", ncols=3, bbox_to_anchor=(0, 1.22))
    return figure


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(render(luck(), ".svg"))
