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
    """Write the lines of a Markdown table, the best after most trainings first.

    Args:
        measured: what `benchmarks.peers_table` writes.
    """
    ends = {name: np.array(one["ends"], dtype=np.float64) for name, one in measured["contenders"].items()}
    best, known = np.min([logs.mean(axis=0) for logs in ends.values()], axis=0), differs(ends)
    yield f"{len(ends[REFERENCE])} searches each, {measured['date']}:"
    yield ""
    yield f"| trainings of {measured['epochs']} epochs | {' | '.join(map(str, measured['budgets']))} |"
    yield f"|---|{'---|' * len(best)}"
    for name, logs in sorted(ends.items(), key=lambda one: float(one[1][:, -1].mean())):
        told = known.get(name, np.zeros(len(best), np.bool_))
        cells = (
            _cell(logs[:, at], is_best=logs[:, at].mean() == best[at], is_told=bool(told[at]))
            for at in range(len(best))
        )
        yield f"| {name} | {' | '.join(cells)} |"


def _cell(logs: NDArray[np.float64], *, is_best: bool, is_told: bool) -> str:
    mean, low, high = interval(logs)
    shown = f"**{mean:.3f}**" if is_best else f"{mean:.3f}"
    return f"{shown}{'*' if is_told else ''} [{low:.3f}, {high:.3f}]"
