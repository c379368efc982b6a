"""Searches of one task beside each other, each by the studied network that its re-estimates choose.

Neither a test score nor a recorded fitness, which is one draw, has a part in that choice. One half of the seeds
chooses, and the other half re-estimates and tests what was chosen, so that luck which chooses a network does not count
for it. Where the halves, each in its turn, choose different networks, the choice itself is a draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.statistics.effects import Effects, Interval, effects, median, superiority
from analysis.statistics.tests import holm, mann_whitney
from analysis.studies.noise import Reestimates
from analysis.studies.scores import Study
from tacevo.randomness import stream
from tacevo.studies.lines import Network

#: The fewest seeds of a study: each half has two.
LEAST_SEEDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class StudiedSearch:
    """A search with its study."""

    #: Of the run.
    name: str
    study: Study
    #: Of the study's networks, on the run's data.
    reestimates: Reestimates


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """How the network of a search differs from that of the first one."""

    #: The chance that a re-estimate is lower.
    lower_loss: Interval
    #: Of the test scores.
    tested: Effects
    #: Mann-Whitney U of the test scores, after Holm's correction over all searches but the first.
    p_holm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """The network of a search that re-estimates choose."""

    search: StudiedSearch
    network: Network
    #: The median of its losses after as many epochs as the search had.
    reestimated: Interval
    #: The median of its test scores.
    tested: Interval
    #: None of the first search.
    difference: Difference | None


def best_by_reestimates(searches: Sequence[StudiedSearch], *, half: int, seed: int = 0) -> tuple[Chosen, ...]:
    """Return the network that is chosen of each search, compared with that of the first.

    Args:
        searches: two or more different ones of one task, of equal epochs; their studies have one data set, recipe
            and number of seeds, `LEAST_SEEDS` or more.
        half: of the seeds, which chooses: 0 for the first, third ..., or 1 for those between them.
        seed: of the bootstrap.
    """
    places = [
        int(np.argmin([np.median(estimates[half::2]) for estimates in search.reestimates.estimates]))
        for search in searches
    ]
    pairs = list(zip(searches, places, strict=True))
    networks = [search.reestimates.networks[place] for search, place in pairs]
    losses = [np.array(search.reestimates.estimates[place][1 - half :: 2]) for search, place in pairs]
    scores = [
        search.study.values(network.name, search.study.primary)[1 - half :: 2]
        for search, network in zip(searches, networks, strict=True)
    ]
    p_values = holm([mann_whitney(own, scores[0]).p for own in scores[1:]])
    differences = [
        Difference(
            lower_loss=superiority(loss, losses[0]),
            tested=effects(score, scores[0], rng=stream(seed, "bootstrap", half, search.study.run)),
            p_holm=p,
        )
        for search, loss, score, p in zip(searches[1:], losses[1:], scores[1:], p_values, strict=True)
    ]
    return tuple(
        Chosen(
            search=search,
            network=network,
            reestimated=median(loss),
            tested=median(score),
            difference=difference,
        )
        for search, network, loss, score, difference in zip(
            searches, networks, losses, scores, [None, *differences], strict=True
        )
    )
