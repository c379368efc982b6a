"""What lies beside a part and is imported by it."""

from collections.abc import Iterable

from tacevo.parts import Candidate


def ranked(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Order candidates by fitness, best first."""
    return sorted(candidates, key=lambda one: (one.fitness, one.id))
