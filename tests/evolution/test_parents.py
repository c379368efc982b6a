"""Promise: each control draws its parents from what it says, and from nothing else."""

from collections import Counter
from dataclasses import replace
from fractions import Fraction

import pytest
from probabilities import agrees

from tacevo.choices import ParentPolicy
from tacevo.evolution.archive import Archive, Elite, insert
from tacevo.evolution.proposals import Candidate, draw_parents, fittest, pool_of_parents
from tacevo.randomness import stream

#: Losses in the order in which the candidates came; g3 is as fit as g1.
LOSSES = (0.5, 0.2, 0.9, 0.2, 0.3, 0.8)

CANDIDATES = {
    f"g{place}": Candidate(id=f"g{place}", source=f"{place}", fitness=loss, curiosities=Fraction(1))
    for place, loss in enumerate(LOSSES)
}

#: What `draw_parents` is tried with.
ELITES = [
    Candidate(id=f"g00s{number:02d}", source=f"{number}", fitness=fitness, curiosities=Fraction(curiosity))
    for number, (fitness, curiosity) in enumerate([(0.3, 0.5), (0.1, 0.5), (0.2, 1.5), (0.4, 1.5)])
]
DRAWS = 2000


def archive(*names: str) -> Archive:
    """Make an archive of elites, whose niches fall from name to name."""
    filled = Archive()
    for niche, name in zip(range(len(names), 0, -1), names, strict=True):
        filled, _ = insert(filled, niche, Elite(name=name, objective=-CANDIDATES[name].fitness))
    return filled


@pytest.mark.parametrize(
    ("policy", "names"),
    [
        *((policy, "g4 g2 g0") for policy in (ParentPolicy.uniform, ParentPolicy.best, ParentPolicy.curiosity)),
        (ParentPolicy.trained, "g0 g1 g2 g3 g4 g5"),
        (ParentPolicy.best_k, "g1 g4 g0"),
    ],
)
def test_pool_is_that_of_the_policy(policy: ParentPolicy, names: str) -> None:
    """Elites by niche; all; the three fittest for three elites."""
    pool = pool_of_parents(policy, CANDIDATES, archive("g0", "g2", "g4"))
    assert " ".join(one.id for one in pool) == names


@pytest.mark.parametrize(("count", "names"), [(1, "g1"), (5, "g1 g4 g0 g5 g2"), (6, "g1 g4 g0 g5 g2")])
def test_fittest_are_different_ones(count: int, names: str) -> None:
    """Best first, the first of equals; fewer where there are no more."""
    assert " ".join(one.id for one in fittest(CANDIDATES.values(), count)) == names


def test_more_parents_than_elites_are_refused() -> None:
    """Drawing two of one is an error."""
    with pytest.raises(ValueError, match="drawing 2 parents needs as many elites; got 1"):
        draw_parents(ParentPolicy.uniform, ELITES[:1], number=2, best=1, rng=stream(0))


@pytest.mark.parametrize(
    ("policy", "shares"),
    [
        (ParentPolicy.uniform, (1 / 4, 1 / 4, 1 / 4, 1 / 4)),
        (ParentPolicy.best, (0, 1 / 2, 1 / 2, 0)),  # the two fittest alike
        (ParentPolicy.curiosity, (1 / 8, 1 / 8, 3 / 8, 3 / 8)),
    ],
)
def test_parents_come_as_often_as_their_policy_says(policy: ParentPolicy, shares: tuple[float, ...]) -> None:
    """Alike, by fitness, or in proportion to curiosity."""
    rng = stream(0, "parents")
    drawn = (draw_parents(policy, ELITES, number=1, best=2, rng=rng) for _ in range(DRAWS))
    counts = Counter(parent.id for (parent,) in drawn)
    for elite, share in zip(ELITES, shares, strict=True):
        assert agrees(counts[elite.id], share, DRAWS) if share else elite.id not in counts


def test_best_are_at_least_as_many_as_are_drawn_and_ranked_by_id_on_a_tie() -> None:
    """A crossover with `best=1` takes the two fittest; the order of niches decides nothing."""
    pair = draw_parents(ParentPolicy.best, ELITES, number=2, best=1, rng=stream(0))
    assert {parent.id for parent in pair} == {"g00s01", "g00s02"}
    tied = [replace(elite, fitness=0.5) for elite in reversed(ELITES)]
    (parent,) = draw_parents(ParentPolicy.best, tied, number=1, best=1, rng=stream(0))
    assert parent.id == "g00s00"
