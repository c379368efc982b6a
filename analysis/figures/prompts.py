"""What came of each instruction of a library."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from analysis.figures.style import BLUE, GREY, house_style, new_figure
from analysis.runs.dynamics import Productivity


@house_style()
def prompt_productivity(prompts: Sequence[Productivity]) -> Figure:
    """Draw the share of each instruction's children that entered the network archive, with its Wilson interval.

    Args:
        prompts: in the order of the library; one that was never tried has its line, and no point on it.
    """
    figure, (axes,) = new_figure("single", 0.55 + 0.145 * len(prompts))
    for place, prompt in enumerate(prompts):
        axes.text(1.03, place, f"{prompt.inserted}/{prompt.tried}", transform=axes.get_yaxis_transform(), va="center")
        if prompt.rate is not None and prompt.interval is not None:
            low, high = prompt.interval
            axes.plot([low, high], [place, place], color=GREY, solid_capstyle="butt")
            axes.plot(prompt.rate, place, "o", color=BLUE, clip_on=False)
    names = [prompt.name.replace("_", " ") for prompt in prompts]
    axes.set_yticks(range(len(prompts)), names, parse_math=False)
    axes.set(xlim=(0, 1), ylim=(len(prompts) - 0.5, -0.5), xlabel="inserted / tried, with 95 % interval")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#DDDDDD")
    axes.set_axisbelow(True)
    return figure
