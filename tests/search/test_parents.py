"""Promise: each control draws its parents from what it says, and from nothing else."""

import math
from dataclasses import replace
from fractions import Fraction

import pytest

from tacevo.choices import ParentPolicy
from tacevo.search.archive import Archive, Elite, insert
from tacevo.search.proposals import Candidate, fittest, pool_of_parents

#: Losses in the order in which the candidates came; g3 is as fit as g1.
LOSSES = (0.5, 0.2, 0.9, 0.2, 0.3, 0.8)

CANDIDATES = {
    f"g{place}": Candidate(id=f"g{place}", source=f"{place}", fitness=loss, curiosities=Fraction(1))
    for place, loss in enumerate(LOSSES)
}


def archive(*names: str) -> Archive:
    """Make an archive of elites, whose niches fall from name to name."""
    found = Archive()
    for niche, name in zip(range(len(names), 0, -1), names, strict=True):
        found, _ = insert(found, niche, Elite(name=name, objective=-CANDIDATES[name].fitness))
    return found


@pytest.mark.parametrize(
    ("policy", "names"),
    [
        *((policy, "g4 g2 g0") for policy in (ParentPolicy.uniform, ParentPolicy.best, ParentPolicy.curiosity)),
        (ParentPolicy.trained, "g0 g1 g2 g3 g4 g5"),
        (ParentPolicy.best_k, "g1 g4 g0"),
        (ParentPolicy.tournament, "g2 g3 g4 g5"),
    ],
)
def test_pool_is_that_of_the_policy(policy: ParentPolicy, names: str) -> None:
    """Elites by niche; all; the three fittest for three elites, a network that came twice once; the four youngest."""
    pool = pool_of_parents(policy, CANDIDATES, archive("g0", "g2", "g4"), population=4)
    assert " ".join(one.id for one in pool) == names


def test_population_that_is_not_full_holds_all() -> None:
    """Nobody leaves before it is full."""
    pool = pool_of_parents(ParentPolicy.tournament, CANDIDATES, archive("g0"), population=7)
    assert list(pool) == list(CANDIDATES.values())


@pytest.mark.parametrize(("count", "names"), [(1, "g1"), (5, "g1 g4 g0 g5 g2"), (6, "g1 g4 g0 g5 g2")])
def test_fittest_are_different_ones(count: int, names: str) -> None:
    """Best first, the first of equals; fewer than asked for where there are no more."""
    assert " ".join(one.id for one in fittest(CANDIDATES.values(), count)) == names


def test_network_that_failed_again_is_not_among_the_fittest() -> None:
    """However few there are."""
    failed = replace(CANDIDATES["g1"], fitness=math.inf)
    assert [one.id for one in fittest([failed, CANDIDATES["g2"]], 2)] == ["g2"]
