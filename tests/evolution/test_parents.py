"""Promise: each control draws its parents from what it says, and from nothing else."""

import math
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


def test_more_parents_than_elites_are_refused() -> None:
    """Drawing two of one is an error."""
    with pytest.raises(ValueError, match="drawing 2 parents needs as many elites; got 1"):
        draw_parents(ParentPolicy.uniform, ELITES[:1], number=2, best=1, tournament=1, rng=stream(0))


def first_parents(policy: ParentPolicy, best: int = 2) -> Counter[str]:
    """Count whom a policy draws."""
    rng = stream(0, "parents")
    drawn = (draw_parents(policy, ELITES, number=1, best=best, tournament=2, rng=rng) for _ in range(DRAWS))
    return Counter(parent.id for (parent,) in drawn)


def test_uniform_parents_are_all_alike() -> None:
    """Every elite is as likely, whatever its fitness."""
    drawn = first_parents(ParentPolicy.uniform)
    assert all(agrees(drawn[elite.id], 1 / 4, DRAWS) for elite in ELITES)


def test_best_parents_are_the_fittest() -> None:
    """Only the `best` elites of lowest loss are drawn, and these alike."""
    drawn = first_parents(ParentPolicy.best)
    assert set(drawn) == {"g00s01", "g00s02"}
    assert agrees(drawn["g00s01"], 1 / 2, DRAWS)


def test_best_is_at_least_as_many_as_are_drawn() -> None:
    """A crossover with `best=1` takes the two fittest."""
    pair = draw_parents(ParentPolicy.best, ELITES, number=2, best=1, tournament=1, rng=stream(0))
    assert {parent.id for parent in pair} == {"g00s01", "g00s02"}


def test_equally_fit_elites_rank_by_id() -> None:
    """A tie for the last place among the best is decided by the id, not by the order of niches."""
    tied = [replace(elite, fitness=0.5) for elite in reversed(ELITES)]
    (parent,) = draw_parents(ParentPolicy.best, tied, number=1, best=1, tournament=1, rng=stream(0))
    assert parent.id == "g00s00"


def test_tournament_is_won_by_the_fittest_of_its_draws() -> None:
    """Of two draws with replacement the r-th fittest of four wins 7, 5, 3 and 1 times of 16."""
    drawn = first_parents(ParentPolicy.tournament)
    shares = {"g00s01": 7 / 16, "g00s02": 5 / 16, "g00s00": 3 / 16, "g00s03": 1 / 16}
    assert all(agrees(drawn[name], share, DRAWS) for name, share in shares.items())


def test_tie_of_a_tournament_is_won_by_the_earlier_one() -> None:
    """The order of the pool decides, whoever is drawn first."""
    tied = [replace(elite, fitness=0.5) for elite in ELITES[:2]]
    for number in range(20):
        drawn = draw_parents(ParentPolicy.tournament, tied, number=1, best=1, tournament=30, rng=stream(0, number))
        assert drawn[0].id == "g00s00"


def test_curious_parents_come_in_proportion() -> None:
    """An elite of three times the curiosity comes three times as often."""
    drawn = first_parents(ParentPolicy.curiosity)
    expected = {"g00s00": 1 / 8, "g00s01": 1 / 8, "g00s02": 3 / 8, "g00s03": 3 / 8}
    assert all(agrees(drawn[name], share, DRAWS) for name, share in expected.items())
