"""Promise: each control draws its parents from what it says, and from nothing else."""

from collections import Counter
from dataclasses import replace
from fractions import Fraction

import pytest
from probabilities import agrees

from tacevo.evolution.parents import Baseline, Best, BestK, Curious, Trained, Uniform, fittest
from tacevo.evolution.proposals import Candidate
from tacevo.parts import Parents, Population
from tacevo.randomness import stream

#: Losses in the order in which the candidates came; g3 is as fit as g1.
LOSSES = (0.5, 0.2, 0.9, 0.2, 0.3, 0.8)

CANDIDATES = {
    f"g{place}": Candidate(id=f"g{place}", source=f"{place}", fitness=loss, curiosities=Fraction(1))
    for place, loss in enumerate(LOSSES)
}

#: What draws are tried with.
ELITES = [
    Candidate(id=f"g00s{number:02d}", source=f"{number}", fitness=fitness, curiosities=Fraction(curiosity))
    for number, (fitness, curiosity) in enumerate([(0.3, 0.5), (0.1, 0.5), (0.2, 1.5), (0.4, 1.5)])
]
DRAWS = 2000


@pytest.mark.parametrize(
    ("policy", "names"),
    [
        *((policy, "g4 g2 g0") for policy in (Uniform(), Best(best=2), Curious())),
        (Trained(), "g0 g1 g2 g3 g4 g5"),
        (BestK(), "g1 g4 g0"),
        (Baseline(), ""),
    ],
)
def test_pool_is_that_of_the_policy(policy: Parents, names: str) -> None:
    """Elites by niche; all; the three fittest for three elites; nobody, which stands for the baseline."""
    elites = [CANDIDATES[name] for name in ("g4", "g2", "g0")]
    pool = policy.pool(Population(generation=1, candidates=CANDIDATES, elites=elites))
    assert " ".join(one.id for one in pool) == names


@pytest.mark.parametrize(("count", "names"), [(1, "g1"), (5, "g1 g4 g0 g5 g2"), (6, "g1 g4 g0 g5 g2")])
def test_fittest_are_different_ones(count: int, names: str) -> None:
    """Best first, the first of equals; fewer where there are no more."""
    assert " ".join(one.id for one in fittest(CANDIDATES.values(), count)) == names


def test_more_parents_than_elites_are_refused() -> None:
    """Drawing two of one is an error."""
    with pytest.raises(ValueError, match="drawing 2 parents needs as many candidates; got 1"):
        Uniform().draw(ELITES[:1], 2, stream(0))


@pytest.mark.parametrize(
    ("policy", "shares"),
    [
        (Uniform(), (1 / 4, 1 / 4, 1 / 4, 1 / 4)),
        (Best(best=2), (0, 1 / 2, 1 / 2, 0)),  # the two fittest alike
        (Curious(), (1 / 8, 1 / 8, 3 / 8, 3 / 8)),
    ],
)
def test_parents_come_as_often_as_their_policy_says(policy: Parents, shares: tuple[float, ...]) -> None:
    """Alike, by fitness, or in proportion to curiosity."""
    rng = stream(0, "parents")
    drawn = (policy.draw(ELITES, 1, rng) for _ in range(DRAWS))
    counts = Counter(parent.id for (parent,) in drawn)
    for elite, share in zip(ELITES, shares, strict=True):
        assert agrees(counts[elite.id], share, DRAWS) if share else elite.id not in counts


def test_best_are_at_least_as_many_as_are_drawn_and_ranked_by_id_on_a_tie() -> None:
    """A crossover with `best=1` takes the two fittest; the order of niches decides nothing."""
    pair = Best(best=1).draw(ELITES, 2, stream(0))
    assert {parent.id for parent in pair} == {"g00s01", "g00s02"}
    tied = [replace(elite, fitness=0.5) for elite in reversed(ELITES)]
    (parent,) = Best(best=1).draw(tied, 1, stream(0))
    assert parent.id == "g00s00"
