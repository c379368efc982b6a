"""Figures from the table of a whole space: the worth of a fitness, and how far a search's network is from the best."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from analysis.statistics.seed_noise import WORTH, worth
from tacevo.rounding import rounded

#: The columns of what a fitness is worth after so many epochs, by each rule.
BY_EPOCHS = {"epochs": "int64", **WORTH}


def worth_by_epochs(losses: ArrayLike, scores: ArrayLike) -> pd.DataFrame | None:
    """Compare what a fitness is worth by each rule after every number of epochs; for the values see `seed_noise.worth`.

    Args:
        losses: validation losses of n networks, S >= 2 seeds and E epochs, shape (n, S, E).
        scores: test scores of the weights of the best validation epoch, lower is better, shape (n, S).

    Returns:
        A row for each number of epochs and rule (`BY_EPOCHS`); None of one seed.
    """
    curves = np.asarray(losses, dtype=np.float64)
    frames = []
    for epochs in range(1, curves.shape[2] + 1):
        rows = worth(curves[:, :, :epochs], scores)
        if rows is None:
            return None
        frames.append(rows.assign(epochs=epochs)[list(BY_EPOCHS)])
    return pd.concat(frames, ignore_index=True).astype(BY_EPOCHS)


def regret(scores: ArrayLike, chosen: int) -> tuple[float, int]:
    """Compare one network of a space with all of them by the mean score over their seeds.

    The best of many means is partly luck, so it is lower than the best network's true mean, and a regret too large.

    Args:
        scores: lower is better, shape (n, S).
        chosen: the network's row, in [0, n).

    Returns:
        Its mean less the lowest mean, at least 0; and its rank among all, from 1, equal ones sharing the best rank.
    """
    means = np.asarray(scores, dtype=np.float64).mean(axis=1)
    own = means[chosen]
    return rounded(float(own - means.min())), 1 + int((means < own).sum())
