"""Which elites of a search are looked at: its best networks, each with a source of its own."""

from collections.abc import Iterable


def best_of_their_own(elites: Iterable[tuple[float, str, str | None]], baseline: str | None) -> list[str]:
    """Rank elites, and pass over those whose source is the baseline's or a better elite's.

    The earlier candidate wins a tie.

    Args:
        elites: fitness (lower is better), id and source of each, in any order.
        baseline: source of the baseline.

    Returns:
        Their ids, best first.
    """
    seen, chosen = {baseline}, []
    for _, name, source in sorted(elites, key=lambda elite: elite[:2]):
        if source not in seen:
            seen.add(source)
            chosen.append(name)
    return chosen
