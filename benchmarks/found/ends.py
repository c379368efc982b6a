"""Test losses beside the baseline's, after short and after long trainings."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import pandas as pd

import tacevo
from analysis.statistics.effects import mean_with_interval
from benchmarks.found.bundles import ROOT, place_of, run, sweep
from benchmarks.found.estimates import AFTERWARDS, PLANNED, Estimate, ratio
from benchmarks.found.records import ARMS
from benchmarks.handed_over import against_baseline, chosen, more_right
from tacevo.storage.sweep_directory import SweepDirectory


class Handed(NamedTuple):
    """Searches of one kind, each with a study of five networks."""

    #: Their sweep, its arm, and what they are.
    bundle: str
    arm: str
    of: str


#: The searches after 70 epochs.
SEARCHES = tuple(Handed("ablation-elites", arm, of) for arm, of in ARMS.items())

#: The control without a search.
CONTROL = Handed("first-mutations", "none", "first mutations, no search")

#: What a search hands over after 70 epochs.
MEAN = "70 epochs, 2 seeds, 8 searches each: mean of five networks"
ONE = "70 epochs, 2 seeds, 8 searches each: one of five, chosen by a full training"

#: How many networks a search's choice is among.
FIVE = 5

_TRAININGS = "trainings"


class OfSeed(NamedTuple):
    """Of the search of one seed: logarithms of the test loss over the baseline's, and points of accuracy above it."""

    of_five: float
    of_one: float
    points: float
    by_reestimates: float


@cache
def of_searches(handed: Handed) -> dict[int, OfSeed]:
    """Return by seed what a search's five networks are worth, and what the one of them that is handed over is."""
    of, values = sweep(handed.bundle), {}
    for job in (job for job in SweepDirectory(of.place.folder).read().jobs if job.arm == handed.arm):
        one = of.run(job.name)
        (study,) = (study for study in one.studies if not (study.is_noise or study.is_choice))
        losses = against_baseline(study.scores)
        values[job.seed] = OfSeed(
            float(losses.to_numpy().mean()),
            float(np.mean([*chosen(study.scores)])),
            float(np.mean([*chosen(study.scores, more_right)])),
            _by_reestimates(one, study.networks.id.drop("baseline"), losses),
        )
    return values


def _by_reestimates(of: tacevo.Run, ids: pd.Series, losses: pd.DataFrame) -> float:
    """Return the worth of the network with the lowest median of its re-estimates; nan where there are none."""
    again = [study.reestimates for study in of.studies if study.reestimates is not None]
    if not again:
        return math.nan
    medians = again[0].groupby("id").fitness.median()
    return float(losses[min(ids.index, key=lambda network: medians[ids[network]])].mean())


def one_of_five() -> Estimate:
    """Return what the chosen network of both arms' searches is worth."""
    return _pooled("both arms", "of_one")


def control() -> Estimate:
    """Return what the network is worth that is chosen among first mutations, without a search."""
    return replace(_row(CONTROL, "of_one", PLANNED), unit="seeds")


def mean_of_five() -> Estimate:
    """Return what the five networks of both arms' searches are worth on the mean."""
    return _pooled("both arms", "of_five")


def _pooled(of: str, field: str) -> Estimate:
    """Return one thing that is known of the searches of both arms as a ratio, over seeds."""
    return ratio(of, _by_seed(field), unit="seeds", bundle="ablation-elites", fixed=AFTERWARDS)


def _by_seed(field: str) -> list[float]:
    """Return by seed one thing that is known of a search, the mean of both arms: they share seeds and baselines."""
    both = [of_searches(each) for each in SEARCHES]
    return [float(np.mean([getattr(arm[seed], field) for arm in both])) for seed in both[0]]


def of_arms(field: str) -> Iterator[Estimate]:
    """Yield one thing that is known of each arm's searches as a ratio, the method first."""
    for each in SEARCHES:
        yield _row(each, field, AFTERWARDS)


def _row(handed: Handed, field: str, fixed: str) -> Estimate:
    """Return one thing that is known of searches of one kind as a ratio."""
    values = [getattr(one, field) for one in of_searches(handed).values()]
    return ratio(handed.of, values, unit="searches", bundle=handed.bundle, fixed=fixed)


def drawn() -> Iterator[Estimate]:
    """Yield how test losses compare with the baseline's after short and after long trainings."""
    for name, of in (("grating-claude", "Claude's"), ("grating-grammar", "the grammar's")):
        (study,) = (study for study in run(name).studies if "epochs6" in study.name)
        for network, logs in against_baseline(study.scores).items():
            named = f"{of} {study.networks.id[network]}"
            row = ratio(named, logs, unit=_TRAININGS, bundle=name, fixed=AFTERWARDS)
            yield replace(row, group="6 epochs, new images, 20 seeds")
    (study,) = run("grating-winners").studies
    for network, logs in against_baseline(study.scores).items():
        by, _, network_id = str(network).partition("_")
        named = f"{'Claude' if by == 'claude' else 'the grammar'}'s {network_id}"
        row = ratio(named, logs, unit=_TRAININGS, bundle="grating-winners", fixed=PLANNED)
        yield replace(row, group="40 epochs, new images, 12 seeds")
    for group, field, both in ((MEAN, "of_five", mean_of_five()), (ONE, "of_one", one_of_five())):
        yield from (replace(row, group=group) for row in (*of_arms(field), both))
    yield replace(control(), group=ONE)
    (study,) = run("grating-chosen-48").studies
    names = {"chosen": "the method's g10s01, seed 0", "by_hand": "two edits by hand"}
    losses = against_baseline(study.scores)
    for network, of in names.items():
        row = ratio(of, losses[network], unit=_TRAININGS, bundle="grating-chosen-48", fixed=PLANNED)
        yield replace(row, group="harder task, 70 epochs, new images, 12 seeds")


def written() -> Iterator[Estimate]:
    """Yield what the page says beside its picture."""
    estimate = partial(Estimate, bundle="ablation-elites", fixed=AFTERWARDS)
    points = _by_seed("points")
    mean, low, high = mean_with_interval(points)
    of = "one of five, both arms: points of accuracy above the baseline"
    yield estimate(of=of, value=mean, ends=(low, high), count=len(points), unit="seeds")
    below = [one.of_one < 0 for each in SEARCHES for one in of_searches(each).values()]
    of = "one of five: searches whose network is below the baseline"
    yield estimate(of=of, value=sum(below), form=f"{{:.0f}} of {len(below)}", count=len(below), unit="searches")
    yield _pooled("one of five, both arms, chosen by re-estimates of ten epochs", "by_reestimates")
    without = of_searches(CONTROL)
    for each in SEARCHES:
        logs = [without[seed].of_one - own.of_one for seed, own in of_searches(each).items()]
        of = f"one of five: first mutations over {each.of}"
        yield ratio(of, logs, unit="seeds", bundle=CONTROL.bundle, fixed=PLANNED)
    yield from _of_the_table()


def _of_the_table() -> Iterator[Estimate]:
    """Yield what the best of five networks of the table's is worth, the five drawn at random, chosen by one training.

    Nothing is drawn: of all draws the network at a place of the order by validation loss is the best in a known part.
    """
    scores = tacevo.open_table(ROOT / place_of("grating-space")).scores
    tested = np.log(scores.pivot_table(index="seed", columns="network", values="cross_entropy"))
    tested = tested.sub(tested[0], axis=0).drop(columns=0)  # network 0 is the baseline
    validated = scores.pivot_table(index="seed", columns="network", values="validation_loss").drop(columns=0)
    networks = len(validated.columns)
    parts = [math.comb(networks - 1 - place, FIVE - 1) / math.comb(networks, FIVE) for place in range(networks)]
    draws = [
        (tested.loc[other, validated.loc[seed].sort_values().index], parts)
        for seed in validated.index
        for other in validated.index.drop(seed)
    ]
    logs = np.concatenate([values for values, _ in draws])
    weights = np.concatenate([weight for _, weight in draws]) / len(draws)
    order = logs.argsort()
    low, high = np.exp(logs[order][np.searchsorted(weights[order].cumsum(), [0.025, 0.975])])
    of = "one of five random networks of the table, 20 epochs"
    estimate = partial(Estimate, bundle="grating-space", fixed=AFTERWARDS, count=networks, unit="networks")
    value = math.exp(float(logs @ weights))
    yield estimate(of=of, value=value)
    yield estimate(of=f"{of}: single draws", value=value, ends=(low, high), interval="95 % of single draws")
    below = 100 * float(weights[logs < 0].sum())
    yield estimate(of=f"{of}: draws below the baseline", value=below, form="{:.0f} %")
