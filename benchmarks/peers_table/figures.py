"""What searches hand over, as a table: geometric means with intervals, each compared with random draws."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import ttest_ind
from statsmodels.stats.multitest import multipletests

from tacevo.randomness import stream

#: The contender that all others are compared with.
REFERENCE = "random draws"

#: Resamples of an interval.
RESAMPLES = 4_000


def interval(logs: ArrayLike) -> tuple[float, float, float]:
    """Return the geometric mean of losses, and its 95 % interval: a bootstrap over the searches, percentiles.

    Args:
        logs: the logarithm of a loss, of each search.
    """
    values = np.asarray(logs, dtype=np.float64)
    rows = stream(0, "peers_table", "bootstrap").integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(values[rows].mean(axis=1), [0.025, 0.975])
    return float(np.exp(values.mean())), float(np.exp(low)), float(np.exp(high))


def differs(ends: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.bool_]]:
    """Answer, of each contender and budget, whether its searches differ from draws: Welch's t of logs, Holm over all.

    Args:
        ends: of each contender, shape (searches, budgets); `REFERENCE` is among them.
    """
    others = [name for name in ends if name != REFERENCE]
    tests = np.array([ttest_ind(ends[name], ends[REFERENCE], equal_var=False).pvalue for name in others])
    rejected = multipletests(np.nan_to_num(tests.ravel(), nan=1.0), method="holm")[0].reshape(tests.shape)
    return dict(zip(others, rejected, strict=True))


def table(measured: Mapping[str, Any]) -> Iterator[str]:
    """Write the lines of a Markdown table, the best after most trainings first; one search has no row.

    Args:
        measured: what `benchmarks.peers_table` writes.
    """
    contenders = measured["contenders"].items()
    ends = {name: np.array(one["ends"], dtype=np.float64) for name, one in contenders if len(one["ends"]) > 1}
    means = {name: logs.mean(axis=0) for name, logs in ends.items()}
    best = [list(means)[row] for row in np.argmin(list(means.values()), axis=0)] if means else []
    told = differs(ends) if len(ends) > 1 and REFERENCE in ends else {}
    libraries = ", ".join(f"{name} {number}" for name, number in measured["libraries"].items())
    yield f"Measured on {measured['date']}, with {libraries}."
    yield ""
    yield f"| trainings of {measured['epochs']} epochs | searches | {' | '.join(map(str, measured['budgets']))} |"
    yield f"|---|---|{'---|' * len(measured['budgets'])}"
    for name in sorted(ends, key=lambda name: float(means[name][-1])):
        cells = []
        for at, lowest in enumerate(best):
            mean, low, high = interval(ends[name][:, at])
            shown = f"**{mean:.3f}**" if name == lowest else f"{mean:.3f}"
            mark = r"\*" if name in told and told[name][at] else ""
            cells.append(f"{shown}{mark} [{low:.3f}, {high:.3f}]")
        yield f"| {name} | {len(ends[name])} | {' | '.join(cells)} |"
