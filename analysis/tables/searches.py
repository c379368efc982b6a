"""The table of searches beside each other."""

from collections.abc import Sequence

import pandas as pd

from analysis.statistics.effects import LEVEL, RESAMPLES
from analysis.studies.metric_names import SHARES, metric_name
from analysis.studies.searches import StudiedSearch, best_by_reestimates
from analysis.table import Interval, PercentInterval, PValue, Table
from analysis.tables.comparison import EFFECTS_LAYOUT, scaled, unit_of
from tacevo.results.grouped import images_tested
from tacevo.results.study import LOWER_IS_BETTER
from tacevo.text import counted


def searches_table(searches: Sequence[StudiedSearch]) -> Table:
    """Show the network that each half of the seeds chooses of each search, and how far it differs from the first's."""
    words, first = ("odd seeds", "even seeds"), searches[0]
    halves = [best_by_reestimates(searches, half=half).assign(by=by) for half, by in enumerate(words)]
    study, metric = first.study, metric_name(first.study.primary)
    choosing = counted(len(first.reestimates.estimates[0]), "seed")
    elsewhere = [f"Tested on other data than the runs': {study.where}."] if study.where else []
    elsewhere += [f"Trained with other settings than the runs': {study.trained_with}."] if study.trained_with else []
    better = "below" if LOWER_IS_BETTER[study.primary] else "above"
    is_share = study.primary in SHARES
    shape, difference = PercentInterval if is_share else Interval, f"difference of medians ({unit_of(study.primary)})"
    return Table.of(
        pd.concat(halves),
        {"chosen by": "by", "search": "search", "candidate": "candidate", "recorded fitness": "fitness"}
        | {"re-estimated": scaled("reestimated", 1), "chance of a lower loss": scaled("lower_loss", 1)}
        | {f"test {metric}": (shape, "tested", "tested_low", "tested_high")}
        | {difference: scaled("difference", 100 if is_share else 1), "A12": EFFECTS_LAYOUT["A12"]}
        | {"p, Holm": (PValue, "p_holm")},
        name="searches" + (f"_{study.fingerprint[:8]}" if study.other_data else ""),
        kind="searches",
        caption=f"The searches of {study.task}, each by the studied network that re-estimates choose; against that of "
        f"{first.name}.",
        notes=(
            *elsewhere,
            f"Chosen: the network, baseline included, with the lowest median fitness "
            f"({first.reestimates.fitness}), by every second of {choosing}, counted "
            "from 1. Re-estimates and tests are of the other seeds, so no training chooses a network and counts for "
            "it. Where odd and even seeds choose different networks, re-estimates do not tell these apart.",
            f"Tested: after {counted(study.recipe.epochs, 'epoch')}, weights of the best validation epoch, on "
            f"{images_tested(study.data, 'image')}.",
            f"In brackets: {100 * LEVEL:g} % intervals, by order statistics of a median, Newcombe's method 5 (2006) "
            f"of the chance and of A12, {RESAMPLES:,} bootstrap resamples of the seeds of the difference.",
            f"A12 is the chance that a seed has a larger {metric} than one of {first.name}: {better} 0.5 it is the "
            "better one. p: two-sided Mann-Whitney U of the test scores; of each half of the seeds, after Holm over "
            "all searches but the first.",
            "One search each: intervals and p hold for the training seeds of these networks. They do not say what "
            "another search of either kind finds, nor what other images show.",
        ),
    )
