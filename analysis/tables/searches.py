"""The table of searches beside each other."""

from collections.abc import Sequence

from analysis.statistics.effects import LEVEL, RESAMPLES
from analysis.studies.metrics import SHARES, metric_name
from analysis.studies.scores import LOWER_IS_BETTER
from analysis.studies.searches import Chosen
from analysis.table import Between, Cell, PercentBetween, PValue, Table
from analysis.tables.comparison import between, unit_of
from tacevo.text import counted


def searches_table(halves: Sequence[Sequence[Chosen]]) -> Table:
    """Show the network that each half of the seeds chooses of each search, and how far it differs from the first's."""
    first = halves[0][0].search
    study, metric = first.study, metric_name(first.study.primary)
    choosing = counted(len(first.reestimates.estimates[0]), "seed")
    elsewhere = f" Tested on other data than the runs': {study.where}." if study.other_data else ""
    better = "below" if LOWER_IS_BETTER[study.primary] else "above"
    return Table(
        name=f"searches_{study.task}" + (f"_{study.fingerprint[:8]}" if study.other_data else ""),
        caption=f"The searches of {study.task}, each by the studied network that re-estimates choose; against that of "
        f"{first.name}.{elsewhere}",
        columns=(
            *("chosen by", "search", "candidate", "recorded fitness", "re-estimated"),
            *("chance of a lower loss", f"test {metric}", f"difference of medians ({unit_of(study.primary)})"),
            *("A12", "p, Holm"),
        ),
        rows=tuple(
            (words, *_cells(one, study.primary))
            for words, found in zip(("odd seeds", "even seeds"), halves, strict=True)
            for one in found
        ),
        notes=(
            f"Chosen: the network, baseline included, with the lowest median loss after "
            f"{counted(first.reestimates.epochs, 'epoch')}, by every second of {choosing}, counted "
            "from 1. Re-estimates and tests are of the other seeds, so no training chooses a network and counts for "
            "it. Where odd and even seeds choose different networks, re-estimates do not tell these apart.",
            f"Tested: after {counted(study.recipe.epochs, 'epoch')}, weights of the best validation epoch, on "
            f"{counted(study.data.counts[2], 'image')}.",
            f"In brackets: {100 * LEVEL:g} % intervals, by order statistics of a median, Newcombe's method 5 (2006) "
            f"of the chance and of A12, {RESAMPLES:,} bootstrap resamples of the seeds of the difference.",
            f"A12 is the chance that a seed has a larger {metric} than one of {first.name}: {better} 0.5 it is the "
            "better one. p: two-sided Mann-Whitney U of the test scores; of each half of the seeds, after Holm over "
            "all searches but the first.",
            "One search each: intervals and p hold for the training seeds of these networks. They do not say what "
            "another search of either kind finds, nor what other images show.",
        ),
    )


def _cells(one: Chosen, metric: str) -> tuple[Cell, ...]:
    shape, factor = (PercentBetween, 100) if metric in SHARES else (Between, 1)
    network, tested, difference = one.network, one.tested, one.difference
    return (
        *(one.search.name, network.id, network.fitness, between(one.reestimated)),
        None if difference is None else between(difference.lower_loss),
        shape(tested.estimate, tested.low, tested.high),
        *(
            (None, None, None)
            if difference is None
            else (
                between(difference.tested.median_difference, factor),
                between(difference.tested.a12),
                PValue(difference.p_holm),
            )
        ),
    )
