"""Who may be a parent: the elites, or what a control puts in their place. Pure.

The controls tell apart what makes a search succeed, at one budget: variation alone (`trained`), selection without
niches (`best_k`), and a search that is known to work without either archive or niches (`tournament`). Their archives
are the same as any other's, but only measure.
"""

import math
from collections.abc import Iterable, Mapping, Sequence

from tacevo.choices import ParentPolicy
from tacevo.search.archive import Archive
from tacevo.search.proposals import Candidate


def pool_of_parents(
    policy: ParentPolicy, candidates: Mapping[str, Candidate], elites: Archive, *, population: int
) -> Sequence[Candidate]:
    """Return the candidates that the parents of a generation are drawn from; `draw_parents` then draws.

    `trained`: all. `best_k`: the `fittest` of all, as many as there are elites. `tournament`: the last `population`
    ones, so that a candidate leaves when it is the oldest, however fit it is (regularised evolution, Real, Aggarwal,
    Huang and Le 2019, arXiv:1802.01548). Any other: the elites, in the order of their niches.

    Args:
        policy: of the parents.
        candidates: every trained candidate by id, in the order of their slots; at least one.
        elites: the network archive.
        population: >= 1.
    """
    match policy:  # only a control looks at all candidates, which takes the longer the more there were
        case ParentPolicy.trained:
            return tuple(candidates.values())
        case ParentPolicy.best_k:
            return fittest(candidates.values(), len(elites.elites))
        case ParentPolicy.tournament:
            return tuple(candidates.values())[-population:]
        case _:
            return elites_of(candidates, elites)


def elites_of(candidates: Mapping[str, Candidate], archive: Archive) -> tuple[Candidate, ...]:
    """Return the elites in the order of their niches."""
    return tuple(candidates[archive.elites[niche].name] for niche in sorted(archive.elites))


def fittest(candidates: Iterable[Candidate], count: int) -> tuple[Candidate, ...]:
    """Return the candidates of least loss, best first, at most `count`.

    Of several exactly as fit only the first one counts, as in an archive without niches (`archive.Places`): a network
    that comes twice is one network. One that failed when it was trained again, of infinite loss, does not count.
    """
    first: dict[float, Candidate] = {}
    for candidate in candidates:
        if math.isfinite(candidate.fitness):
            first.setdefault(candidate.fitness, candidate)
    return tuple(first[fitness] for fitness in sorted(first)[:count])
