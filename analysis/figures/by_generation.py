"""How a search went: fitness, trainable candidates, archives and temperature by generation; children by instruction."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from analysis.figures.axes import (
    count_along,
    name_coinciding,
    name_point,
    on_loss_axis,
    spread,
    title_unsent_temperatures,
)
from analysis.figures.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    OUTLINED,
    PURPLE,
    SKY,
    VERMILLION,
    house_style,
    new_figure,
)
from tacevo.records import Stage
from tacevo.results.run import RecordedRun

#: The most re-estimates that have their names beside them; more would lie on each other.
_NAMED = 8

#: How candidates that a stage rejected are drawn: label, colour, hatching.
_STAGES = {
    Stage.extract: ("no class found", ORANGE, "////"),
    Stage.policy: ("against the policy", SKY, "\\\\\\\\"),
    Stage.probe: ("failed the probe", PURPLE, "xxxx"),
    Stage.train: ("failed in training", GREY, "...."),
}


@house_style()
def fitness_evolution(
    run: RecordedRun, medians: Sequence[float | None], again: Mapping[str, float] | None = None
) -> Figure:
    """Draw best and median fitness of the network archive, and the median of each generation's new candidates.

    The record flatters: beside it stand the baseline, and what networks have with other seeds, each joined by a line
    to its fitness on record.

    Args:
        run: the run.
        medians: of the archive after each generation; None before anything was trained.
        again: the re-estimates of candidates by id; those of the baseline, too.
    """
    figure, (axes,) = new_figure("single", 2.5)
    generations = [entry.generation for entry in run.generations]
    best = [entry.best for entry in run.generations]
    new = [entry.generation_median for entry in run.generations]
    # None becomes NaN, which is not drawn.
    lines = [np.array(values, dtype=np.float64) for values in (new, medians, best)]
    axes.plot(generations, lines[0], color=GREY, linestyle=":", marker="^", label="median of new")
    axes.plot(generations, lines[1], color=VERMILLION, linestyle="--", marker="s", label="archive median")
    axes.plot(generations, lines[2], color=BLUE, marker="o", label="best so far")
    baseline = run.baseline.fitness
    if baseline is not None:
        axes.axhline(baseline, color=BLACK, linestyle=(0, (5, 2)), linewidth=0.8, zorder=1, label="baseline")
    estimates = _reestimates(axes, run, again or {})
    on_loss_axis(axes, [*best, *medians, *new, baseline, *estimates])
    count_along(axes, "generation")
    name_coinciding(axes)
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.4)
    return figure


def _reestimates(axes: Axes, run: RecordedRun, again: Mapping[str, float]) -> list[float]:
    """Draw re-estimates where their networks were made, side by side within a generation; return them."""
    known: dict[int, list[tuple[str, float]]] = {}
    for line in run.trained:
        if line.id in again and line.fitness is not None:
            known.setdefault(line.generation, []).append((line.id, line.fitness))
    drawn = []
    is_named = sum(map(len, known.values())) <= _NAMED
    last = max((entry.generation for entry in run.generations), default=0)
    for generation, those in known.items():
        for number, (place, (name, recorded)) in enumerate(zip(spread(generation, len(those)), those, strict=True)):
            mark: dict[str, Any] = {"color": BLACK if name == run.baseline.id else ORANGE, "zorder": 4, **OUTLINED}
            axes.plot([place] * 2, [recorded, again[name]], color=mark["color"], linewidth=0.8, zorder=3)
            axes.plot(place, recorded, "_", color=mark["color"], markersize=5, zorder=3)
            axes.plot(place, again[name], "D", markersize=4.2, **mark)
            if is_named:  # side by side, one name is to the left and one to the right; at the ends there is one side
                is_left = generation > 0.8 * last or (generation > 0 and number < (len(those) - 1) / 2)
                name_point(axes, name, (place, again[name]), is_left=is_left)
            drawn.append(again[name])
    if drawn:
        axes.plot([], [], "D", markersize=4.2, color=ORANGE, label="with other seeds")
        axes.plot([], [], "_", markersize=5, color=ORANGE, label="on record")
    return drawn


@house_style()
def trainable(generations: pd.DataFrame) -> Figure:
    """Draw how many first answers of each generation were trained or skipped, and where the others were rejected."""
    figure, (axes,) = new_figure("single", 2.4)
    numbers, floor = generations.index.to_numpy(), generations.trained.to_numpy()
    axes.bar(numbers, floor, 0.82, color=BLUE, edgecolor="white", label="trained")
    skipped = generations.skipped.fillna(0).to_numpy("int64")
    if skipped.any():
        axes.bar(numbers, skipped, 0.82, floor, color="white", edgecolor=BLUE, label="skipped")
        floor = floor + skipped
    for stage, (label, colour, hatch) in _STAGES.items():
        counts = generations[f"rejected_{stage}"].to_numpy()
        if counts.any():
            axes.bar(numbers, counts, 0.82, floor, color=colour, edgecolor="white", hatch=hatch, label=label)
        floor = floor + counts
    axes.set_ylabel("candidates")
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    count_along(axes, "generation")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


@house_style()
def growth(run: RecordedRun, prompt_niches: int, reachable: int) -> Figure:
    """Draw the coverage of both archives and the QD-score of the network archive.

    An archive without niches covers its places, and its QD-score is a sum over the best networks. Of the niches of the
    prompt archive only those count that a trial could reach; without any it is not drawn.
    """
    figure, (upper, lower) = new_figure("single", 3.2, rows=2)
    generations = [entry.generation for entry in run.generations]
    networks = [100 * entry.coverage for entry in run.generations]
    held = "networks" if run.has_niches else "networks (of the places for the best)"
    over: dict[str, Any] = {"clip_on": False, "zorder": 3}
    upper.plot(generations, networks, color=BLUE, marker="o", label=held, **over)
    if reachable:
        prompts = [100 * entry.prompt_coverage * prompt_niches / reachable for entry in run.generations]
        words = f"prompts (of the {reachable} niches in reach, of {prompt_niches})"
        upper.plot(generations, prompts, color=ORANGE, linestyle="--", marker="s", label=words, **over)
    upper.set(ylabel="niches occupied (%)" if run.has_niches else "occupied (%)", ylim=(0, 100))
    figure.legend(loc="outside upper center", ncols=2 if run.has_niches else 1)
    lower.plot(generations, [entry.qd_score for entry in run.generations], color=GREEN, marker="D", **over)
    lower.set_ylabel("QD-score")
    lower.set_ylim(bottom=0)
    name_coinciding(upper)
    for axes in (upper, lower):
        count_along(axes, "generation")
    upper.set_xlabel("")
    upper.tick_params(labelbottom=False)
    return figure


@house_style()
def temperature(run: RecordedRun) -> Figure:
    """Draw T_g of each generation, and the temperature that each request around it was sent with.

    A title says where temperatures were not sent.
    """
    figure, (axes,) = new_figure("single", 2.2)
    sent = [(entry.generation, entry.sent_temperature) for entry in run.candidates]
    asked = [(generation, value) for generation, value in sent if value is not None]
    if asked:
        axes.plot(*zip(*asked, strict=True), ".", color=GREY, markersize=2, label="requests")
    generations = [entry.generation for entry in run.generations]
    centres = [entry.temperature for entry in run.generations]
    axes.step(generations, centres, where="mid", color=BLUE, label="$T_g$ of the generation")
    axes.set(ylabel=f"temperature{run.carried}", ylim=(-0.02, 1.02))
    title_unsent_temperatures(axes, run)
    count_along(axes, "generation")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@house_style()
def prompt_productivity(prompts: pd.DataFrame) -> Figure:
    """Draw the share of each instruction's children that entered the network archive, with its Wilson interval.

    One that was never tried has its line, and no point on it.
    """
    figure, (axes,) = new_figure("single", 0.55 + 0.145 * len(prompts))
    for place, prompt in enumerate(prompts.itertuples()):
        axes.text(1.03, place, f"{prompt.inserted}/{prompt.tried}", transform=axes.get_yaxis_transform(), va="center")
        if prompt.tried:
            axes.plot([prompt.rate_low, prompt.rate_high], [place, place], color=GREY, solid_capstyle="butt")
            axes.plot(prompt.rate, place, "o", color=BLUE, clip_on=False)
    names = [name.replace("_", " ") for name in prompts.name]
    axes.set_yticks(range(len(prompts)), names, parse_math=False)
    axes.set(xlim=(0, 1), ylim=(len(prompts) - 0.5, -0.5), xlabel="inserted / tried, with 95 % interval")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#DDDDDD")
    axes.set_axisbelow(True)
    return figure
