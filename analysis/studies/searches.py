"""Searches of one task beside each other: the network that each hands over, re-estimated and tested.

A search hands over the studied network with the lowest re-estimated fitness, its baseline included: no test score has
a part in that choice, and no recorded fitness, which is one draw.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.statistics.effects import Effects, Interval, effects, median
from analysis.statistics.tests import holm, mann_whitney
from analysis.studies.noise import Reestimates
from analysis.studies.scores import Study
from tacevo.randomness import stream
from tacevo.studies.lines import Network


@dataclass(frozen=True, slots=True, kw_only=True)
class Searched:
    """A search with its study."""

    #: Of the run.
    name: str
    study: Study
    #: By the same study.
    again: Reestimates


@dataclass(frozen=True, slots=True, kw_only=True)
class HandedOver:
    """The network that a search hands over."""

    search: Searched
    network: Network
    #: The median of its losses under the study's seeds, after as many epochs as the search had.
    reestimated: float
    #: Of its test scores.
    tested: Interval
    #: Its test scores against those of the first search's network; None of the first.
    effects: Effects | None
    #: Mann-Whitney U of the same, after Holm's correction over all searches but the first; None of the first.
    p_holm: float | None


def handed_over(searches: Sequence[Searched], *, seed: int = 0) -> tuple[HandedOver, ...]:
    """Return what each search hands over, compared with what the first one does.

    Args:
        searches: two or more of one task; their studies are alike (`check_alike`).
        seed: of the bootstrap.
    """
    chosen = [_chosen(search) for search in searches]
    values = [
        search.study.values(network.name, search.study.primary)
        for search, (network, _) in zip(searches, chosen, strict=True)
    ]
    first, others = values[0], values[1:]
    sizes = [
        effects(own, first, rng=stream(seed, "bootstrap", search.name))
        for search, own in zip(searches[1:], others, strict=True)
    ]
    p_values = holm([mann_whitney(own, first).p for own in others])
    return tuple(
        HandedOver(
            search=search,
            network=network,
            reestimated=loss,
            tested=median(own),
            effects=size,
            p_holm=p,
        )
        for search, (network, loss), own, size, p in zip(
            searches, chosen, values, [None, *sizes], [None, *p_values], strict=True
        )
    )


def _chosen(search: Searched) -> tuple[Network, float]:
    """Return the network with the lowest re-estimate, the first one of several, and that re-estimate."""
    known = zip(search.again.networks, search.again.noise.networks, strict=True)
    losses = [(one.median, network) for network, one in known]
    loss, network = min(losses, key=lambda pair: pair[0])
    return network, loss
