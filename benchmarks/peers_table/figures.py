"""What searches hand over, as a table: geometric means with intervals, each compared with random draws."""

from collections.abc import Iterator, Mapping
from typing import Any

from analysis.statistics.tests import holm
from benchmarks.judging import Space, mean, of_budget, p_value, written

#: The contender that all others are compared with.
REFERENCE = "random draws"


def differs(space: Space, contenders: Mapping[str, Any], budgets: int) -> set[tuple[str, int]]:
    """Return the contenders that differ from draws, each with the number of a budget: p < 0.05 after Holm over all."""
    asked = [(name, at) for name in contenders if name != REFERENCE for at in range(budgets)]
    if not asked or REFERENCE not in contenders:
        return set()
    draws = contenders[REFERENCE]
    p = [p_value(mean(space, of_budget(contenders[name], at), of_budget(draws, at))) for name, at in asked]
    return {one for one, corrected in zip(asked, holm(p), strict=True) if corrected < 0.05}


def table(space: Space, measured: Mapping[str, Any]) -> Iterator[str]:
    """Write the lines of a Markdown table, the best after most trainings first; one search has no row.

    Args:
        space: of the table that was searched; its judge says how good a network is.
        measured: what `benchmarks.peers_table` writes.
    """
    contenders = {name: one for name, one in measured["contenders"].items() if len(one["searches"]) > 1}
    budgets = measured["budgets"]
    means = {name: [mean(space, of_budget(one, at)) for at in range(len(budgets))] for name, one in contenders.items()}
    lowest = [min((of_all[at].value for of_all in means.values()), default=0.0) for at in range(len(budgets))]
    told = differs(space, contenders, len(budgets))
    libraries = ", ".join(f"{name} {number}" for name, number in measured["libraries"].items())
    yield f"Measured on {measured['date']}, with {libraries}."
    yield ""
    yield f"| trainings of {measured['epochs']} epochs | searches | {' | '.join(map(str, budgets))} |"
    yield f"|---|---|{'---|' * len(budgets)}"
    for name in sorted(means, key=lambda name: means[name][-1].value):
        cells = []
        for at, one in enumerate(means[name]):
            mark = r" \*" if (name, at) in told else ""
            cells.append(f"**{written(one)}**{mark}" if one.value == lowest[at] else f"{written(one)}{mark}")
        yield f"| {name} | {means[name][0].searches} | {' | '.join(cells)} |"
