"""What accuracy costs: every trained candidate, the front, and the hypervolume by generation."""

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from analysis.figures.axes import count_along, logarithmic, name_point
from analysis.figures.style import BLACK, BLUE, GREY, ORANGE, OUTLINED, house_style, new_figure
from analysis.runs.pareto import REESTIMATED


@house_style()
def pareto(candidates: pd.DataFrame, front: pd.DataFrame, baseline: str, generations: pd.DataFrame) -> Figure:
    """Draw loss against FLOPs, and the hypervolume of each generation.

    Args:
        candidates: every trained one (`analysis.runs.pareto.PARETO`).
        front: those that no other one beats.
        baseline: id of the baseline.
        generations: as of `analysis.runs.pareto.with_hypervolumes`.
    """
    figure, (upper, lower) = new_figure("single", 4.4, rows=2)
    upper.plot(candidates.flops, candidates.fitness, "o", color=GREY, markersize=2, label="trained")
    edge = front.sort_values("flops")
    upper.step(edge.flops, edge.fitness, where="post", color=BLUE, linewidth=0.8)
    again = edge.estimate == REESTIMATED
    for those, marker, colour, label in ((~again, "s", BLUE, "front"), (again, "D", ORANGE, "front, re-estimated")):
        if those.any():
            upper.plot(edge.flops[those], edge.fitness[those], marker, color=colour, label=label)
    if baseline in candidates.index:
        of_baseline = candidates.loc[baseline]
        mark = {"color": BLACK, "markersize": 7, "zorder": 4, **OUTLINED}  # above the points, which would hide it
        upper.plot(of_baseline.flops, of_baseline.fitness, "^", label="baseline", **mark)
        name_point(upper, "baseline", (of_baseline.flops, of_baseline.fitness))
    upper.set(xlabel="FLOPs of one image", ylabel="validation loss")
    logarithmic(upper.xaxis, EngFormatter(sep=""))
    if candidates.fitness.min() > 0:
        logarithmic(upper.yaxis)
    lower.plot(generations.index, 100 * generations.hypervolume, color=BLUE, marker="o", clip_on=False, zorder=3)
    lower.set(ylabel="hypervolume (% of the box)", ylim=(0, 100))
    count_along(lower, "generation")
    figure.legend(loc="outside upper center", ncols=2)
    return figure
