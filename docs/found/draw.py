"""Draw what was found, one picture a question, from the published runs alone.

    python docs/found/draw.py build/paper/found        # as `make paper` does
    python docs/found/draw.py docs/found               # the pictures of these pages

Nearly every figure is a ratio of losses with its interval, so that pictures can be compared: below 1 is better.
"""

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

import tacevo
from analysis.figures.style import BLACK, BLUE, GREY, VERMILLION, house_style, new_figure, render
from analysis.statistics.effects import mean_with_interval
from analysis.sweeps.pairs import LEAST
from benchmarks.handed_over import against_baseline, chosen

PUBLISHED = Path(__file__).parents[2] / "cache/published"

#: The runs that had to make room: read as well as the others, and kept where the tests are.
KEPT = Path(__file__).parents[2] / "tests/golden/bundles"


#: Where the axis of ratios may have ticks.
TICKS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0)


class Ratio(NamedTuple):
    """A ratio with the ends of its 95 % interval."""

    of: str
    value: float
    low: float
    high: float
    #: Of how many values.
    count: int

    def __str__(self) -> str:
        """Write the ratio as the pages do."""
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


def ratio(of: str, logarithms: Iterable[float]) -> Ratio:
    """Return the geometric mean of ratios with Student's interval of their logarithms."""
    values = [*logarithms]
    mean, low, high = map(math.exp, mean_with_interval(values))
    return Ratio(of, mean, low, high, len(values))


def _factor(row: pd.Series) -> tuple[float, float, float, int]:
    """Return the factor of an arm of pairs, the ends of its interval, and of how many questions it is."""
    return row.factor, row.factor_low, row.factor_high, int(row.questions)


@cache
def opened(name: str) -> "tacevo.Run | tacevo.Sweep":
    """Open a published run or sweep by its name."""
    places = [place for root in (PUBLISHED, KEPT) if (place := root / f"{name}.zip").is_file()]
    return tacevo.open(places[0])


def sweep(name: str) -> "tacevo.Sweep":
    """Open a published sweep."""
    found = opened(name)
    assert isinstance(found, tacevo.Sweep)
    return found


def run(name: str) -> "tacevo.Run":
    """Open a published run."""
    found = opened(name)
    assert isinstance(found, tacevo.Run)
    return found


class Winner(NamedTuple):
    """The best network of a search: its loss on record, and with other training seeds, over those of the baseline."""

    search: str
    on_record: float
    again: float


@cache
def winners() -> tuple[Winner, ...]:
    """Return the best of every published search whose winner and baseline were trained again."""
    elites = sweep("ablation-elites")
    searches = [(f"{job.arm}, seed {job.seed}", elites.run(str(job.Index))) for job in elites.jobs.itertuples()]
    searches += [("Claude, 21 generations", run("grating-claude")), ("grammar, 21 generations", run("grating-grammar"))]
    found = []
    for name, one in searches:
        again = next(study.reestimates for study in one.studies if study.reestimates is not None)
        medians = again.groupby("id").fitness.median()
        recorded = again.groupby("id").recorded.first()
        best = recorded.drop("g00s00").idxmin()
        found.append(Winner(name, recorded[best] / recorded["g00s00"], medians[best] / medians["g00s00"]))
    return tuple(found)


@house_style()
def records() -> Figure:
    """Draw what is left of a record with other training seeds, a row a search."""
    figure, (axes,) = new_figure("double", 3.4)
    ordered = sorted(winners(), key=lambda one: one.again)
    for row, one in enumerate(ordered):
        axes.plot([one.on_record, one.again], [row, row], color=GREY, zorder=1)
    rows = range(len(ordered))
    axes.plot([one.on_record for one in ordered], rows, "o", color=BLUE, markerfacecolor="white", label="on record")
    axes.plot([one.again for one in ordered], rows, "o", color=BLUE, label="with other training seeds")
    _complete(axes, [one.search for one in ordered], "best network's validation loss, baseline = 1")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def ends_rows() -> Iterator[Ratio]:
    """Yield how test losses compare with the baseline's after short and after long trainings."""
    for name, of in (("grating-claude", "Claude's"), ("grating-grammar", "grammar's")):
        for study in run(name).studies:
            if "epochs6" in study.name:
                for network, logs in against_baseline(study.scores).items():
                    yield ratio(f"6 epochs: {of} {network}", logs)
    (winning,) = run("grating-winners").studies
    for network, logs in against_baseline(winning.scores).items():
        yield ratio(f"40 epochs: {str(network).replace('_', ' ')}", logs)
    for arm in ("none", "drift"):
        yield ratio(f"70 epochs: mean of five, {arm}", [mean for mean, _ in _elites(arm).values()])
        yield ratio(f"70 epochs: one chosen by a training, {arm}", [one for _, one in _elites(arm).values()])
    (harder,) = run("grating-chosen-48").studies
    names = {"chosen": "the chosen elite", "by_hand": "two edits by hand"}
    for network, logs in against_baseline(harder.scores).items():
        yield ratio(f"harder task, 70 epochs: {names[str(network)]}", logs)


def _elites(arm: str) -> dict[int, tuple[float, float]]:
    """Return by seed the mean of a search's five elites, and the one that one seed chooses and the other tests."""
    elites, values = sweep("ablation-elites"), {}
    for job in elites.jobs[elites.jobs.arm == arm].itertuples():
        (study,) = (one for one in elites.run(str(job.Index)).studies if not one.is_noise)
        of_five = float(against_baseline(study.scores).to_numpy().mean())
        values[int(job.seed)] = of_five, float(np.mean([*chosen(study.scores)]))
    return values


def ends() -> Figure:
    """Draw test losses beside the baseline's, after six epochs and after training to the end."""
    return forest([*ends_rows()], "test loss, baseline = 1")


def paper_networks() -> Figure:
    """Draw the test losses of the paper's networks, rebuilt."""
    rows = []
    for name, task in (("grating-variants", "gratings"), ("force-variants", "forces")):
        (study,) = run(name).studies
        rows += [ratio(f"{task}: {network}", logs) for network, logs in against_baseline(study.scores).items()]
    return forest(rows, "test loss, baseline = 1")


def operator_rows() -> Iterator[Ratio]:
    """Yield what children of first mutations and of elites have beside their parents, and beside each other."""
    compared = sweep("operator-or-search")
    for name, of in (("parents", "first mutations"), ("selected", "elites")):
        (job,) = compared.jobs.index[compared.jobs.arm == f"search.networks=[{name}]"]
        candidates = compared.run(str(job)).candidates
        losses = dict(zip(candidates.index, np.log(candidates.fitness), strict=True))
        children = candidates[candidates.generation == 1]
        logs = [losses[child] - losses[parents[0]] for child, parents in children.parents.items()]
        yield ratio(f"children of {of} / their parents", logs)
    arms = compared.pairs("search.networks=[parents]", other_parents=True).arms
    one = arms.loc["search.networks=[selected]"]
    yield Ratio("children of elites / of first mutations", *_factor(one))


def operator() -> Figure:
    """Draw how good a child is by its parents."""
    return forest([*operator_rows()], "loss, ratio")


def by_hand() -> Figure:
    """Draw the test losses of two edits by hand on three sets of images."""
    rows = []
    for name, of in (
        ("grating-by-hand", "32 px"),
        ("grating-by-hand-48", "48 px, finer"),
        ("grating-chosen-48", "the same, new images"),
    ):
        (study,) = run(name).studies
        rows += [ratio(of, logs) for network, logs in against_baseline(study.scores).items() if network == "by_hand"]
    return forest(rows, "test loss, baseline = 1")


@house_style()
def model_or_grammar() -> Figure:
    """Draw what a quarter of the proposals of each search reach: a point a search."""
    figure, (axes,) = new_figure("single", 1.3)
    jobs = sweep("claude-vs-grammar").jobs
    arms = {"none": "Claude", "llm_vs_grammar": "grammar"}
    for row, (arm, name) in enumerate(arms.items()):
        values = jobs.new_quartile[jobs.arm == arm]
        axes.plot(values, [row] * len(values), "o", color=(BLUE, VERMILLION)[row], label=name)
    axes.set(yticks=[0, 1], yticklabels=[*arms.values()], ylim=(1.5, -0.5))
    axes.set_xlabel("loss that a quarter of the proposals reach")
    axes.grid(axis="x", color="#DDDDDD")
    return figure


def proposals_rows() -> list[Ratio]:
    """Return the arms' proposals as multiples of those of `none`, the same seed in both."""
    jobs = sweep("ablation-proposals").jobs
    values = np.log(jobs.pivot_table(index="seed", columns="arm", values="new_quartile"))
    arms = [arm for arm in jobs.arm.unique() if arm not in {"none", "no_prompt_archive"}]
    return [ratio(str(arm), values[arm] - values["none"]) for arm in arms]


def ablation() -> Figure:
    """Draw the arms of the ablation against the method as published."""
    return forest(proposals_rows(), "loss that a quarter of the proposals reach, none = 1")


@house_style()
def words() -> Figure:
    """Draw how far two answers to one question lie apart, by the sentence that carries the temperature."""
    figure, (axes,) = new_figure("single", 1.4)
    apart = sweep("words-temperature").pairs("temperature.start=0.1").diversity
    assert apart is not None
    for row, (_, one) in enumerate(apart.iterrows()):
        axes.plot(one.operations, row, "o", color=BLUE)
    texts = {"0.1": "change one thing", "0.5": "the third sentence", "0.9": "depart boldly"}
    names = [next(text for key, text in texts.items() if str(arm).endswith(key)) for arm in apart.index]
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5), xlim=(0, None))
    axes.set_xlabel("distance of two answers' operations")
    axes.grid(axis="x", color="#DDDDDD")
    return figure


def telling_rows() -> list[Ratio]:
    """Return the loss of answers that were told losses as a multiple of that of answers that were not."""
    arms = sweep("telling-losses").pairs("prompts.tells=[]").arms
    names = {"[fitness]": "told the parent's loss", "[shuffled]": "told another network's"}
    return [
        Ratio(name, *_factor(one))
        for key, name in names.items()
        for arm, one in arms.iterrows()
        if str(arm).endswith(key)
    ]


def telling() -> Figure:
    """Draw what telling losses changes."""
    return forest(telling_rows(), "loss of the answers, untold = 1")


def summary_rows() -> Iterator[Ratio]:
    """Yield a row a question, each a ratio of losses."""
    elites = [one for one in winners() if "generations" not in one.search]
    seeds = range(len(elites) // 2)
    of_seed = [[np.log(one.again) for one in elites if one.search.endswith(f" {seed}")] for seed in seeds]
    yield ratio("1. A record's network, other seeds / baseline", map(np.mean, of_seed))
    both = [_elites("none"), _elites("drift")]
    yield ratio("2. Mean of five elites, 70 epochs / baseline", [np.mean([arm[s][0] for arm in both]) for s in seeds])
    yield ratio("    one chosen by a full training / baseline", [np.mean([arm[s][1] for arm in both]) for s in seeds])
    jobs = sweep("claude-vs-grammar").jobs
    quartiles = np.log(jobs.pivot_table(index="seed", columns="arm", values="new_quartile"))
    yield ratio("3. Claude's proposals / the grammar's", quartiles["none"] - quartiles["llm_vs_grammar"])
    for one in proposals_rows():
        if one.of in {"drift", "best_k"}:
            names = {"drift": "4. Proposals without selection / with", "best_k": "    without niches / with"}
            yield one._replace(of=names[one.of])
    for name, task in (("grating-variants", "5. Paper's grating"), ("force-variants", "    paper's force")):
        (study,) = run(name).studies
        yield ratio(f"{task} networks / baseline", against_baseline(study.scores).mean(axis=1))
    told, _ = telling_rows()
    yield told._replace(of="6. Answers told the losses / untold")
    *_, of_elites = operator_rows()
    yield of_elites._replace(of="7. Claude's children of elites / of first mutations")


def summary() -> Figure:
    """Draw what was found, a row a question."""
    return forest([*summary_rows()], "ratio of losses: below 1 is better")


@house_style()
def forest(rows: Sequence[Ratio], label: str) -> Figure:
    """Draw ratios with their intervals, one a row, and the line of no difference."""
    figure, (axes,) = new_figure("double", 0.55 + 0.19 * len(rows))
    for place, row in enumerate(rows):
        clear = row.count >= LEAST and (row.high < 1 or row.low > 1)
        axes.plot([row.low, row.high], [place, place], color=BLUE, solid_capstyle="butt")
        axes.plot(row.value, place, "o", color=BLUE, markerfacecolor=BLUE if clear else "white", markersize=4.5)
        axes.text(1.02, place, str(row), transform=axes.get_yaxis_transform(), va="center")
    _complete(axes, [row.of for row in rows], label)
    return figure


def _complete(axes: Axes, names: Sequence[str], label: str) -> None:
    """Name the rows, draw the line of no difference, and lay out the logarithmic axis."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xticks([tick for tick in TICKS if low * 0.95 <= tick <= high * 1.05])
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
    axes.axvline(1, color=BLACK, linewidth=0.8, zorder=0)
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5), xlabel=label)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#DDDDDD")
    axes.set_axisbelow(True)


#: The pictures, by the names of their files.
PICTURES: dict[str, Callable[[], Figure]] = {
    "summary": summary,
    "records": records,
    "ends": ends,
    "model_or_grammar": model_or_grammar,
    "ablation": ablation,
    "paper_networks": paper_networks,
    "words": words,
    "telling": telling,
    "operator": operator,
    "by_hand": by_hand,
}


def main(place: str) -> None:
    """Draw all pictures into a directory."""
    folder = Path(place)
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in PICTURES.items():
        (folder / f"{name}.svg").write_bytes(render(draw(), ".svg"))


if __name__ == "__main__":
    main(sys.argv[1])
