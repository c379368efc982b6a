"""Figures from the table of a whole space: the worth of a fitness, and how good the network is that a search finds.

A network that was chosen by a training is never judged by it: all losses here are of the seeds that did not choose.
"""

from collections.abc import Collection

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from analysis.statistics.seed_noise import WORTH, agreement, icc
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.results.judged_loss import log_loss, mean_log_loss
from tacevo.rounding import rounded

#: The columns of what a fitness is worth after so many epochs, by each rule. `judged_by` says which seeds judge:
#: `recorded`, or `fresh`, those of a judge, and then all is among its networks alone.
BY_EPOCHS = {
    "epochs": "int64",
    **{name: kind for name, kind in WORTH.items() if name != "median"},
    "judged_by": "str",
}


def unseen_loss(losses: ArrayLike, seen: Collection[int]) -> float:
    """Judge a network by the seeds that did not choose it.

    Args:
        losses: its test losses, 0 or more, a seed each, shape (S,).
        seen: the seeds that whoever chose it has looked at, each in [0, S); others are left.

    Returns:
        The mean logarithm of the losses under the other seeds; minus infinity where one is 0.

    Raises:
        ValueError: no seed is left.
    """
    left = np.delete(np.asarray(losses, dtype=np.float64), list(seen))
    if not left.size:
        raise ValueError("expected a seed that did not choose the network; all of them did")
    return rounded(mean_log_loss(left.tolist()))


def best_unseen_loss(losses: ArrayLike) -> float:
    """Return the loss of the best network that all seeds but one can choose, judged by that one.

    The lowest mean over all seeds is partly luck. Here each seed judges once, and the others choose.

    Args:
        losses: test losses, 0 or more, of n networks under S >= 2 seeds, shape (n, S).

    Returns:
        The mean over the seeds of the logarithm of the chosen network's loss; of equal networks the first is chosen.
    """
    rows = np.asarray(losses, dtype=np.float64).tolist()
    logs = np.array([[log_loss(loss) for loss in row] for row in rows])
    seeds = range(logs.shape[1])
    chosen = [int(np.delete(logs, seed, axis=1).mean(axis=1).argmin()) for seed in seeds]
    return rounded(float(np.mean([logs[row, seed] for row, seed in zip(chosen, seeds, strict=True)])))


def worth_by_epochs(losses: ArrayLike, scores: ArrayLike) -> pd.DataFrame | None:
    """Compare what a fitness is worth by each rule after every number of epochs.

    Args:
        losses: validation losses of n networks, S >= 2 seeds and E epochs, shape (n, S, E).
        scores: test losses, 0 or more, of the weights of the best validation epoch: under the same seeds, shape (n, S).

    Returns:
        A row for each number of epochs and rule (`BY_EPOCHS`): the ICC of one training with its interval, and
        Kendall's tau of the fitness under one seed with `unseen_loss`, the mean over the seeds. None of one seed.
    """
    curves, tests = np.asarray(losses, dtype=np.float64), np.asarray(scores, dtype=np.float64)
    seeds = range(tests.shape[1])
    if len(seeds) < 2:
        return None
    judged = np.array([[unseen_loss(row, [seed]) for seed in seeds] for row in tests])
    return _worth(curves, judged, "recorded")


def worth_by_judge(losses: ArrayLike, fresh: ArrayLike) -> pd.DataFrame:
    """Do what `worth_by_epochs` does with seeds that only judge.

    Args:
        losses: validation losses of n networks, S seeds and E epochs, shape (n, S, E).
        fresh: test losses, 0 or more, under F other seeds, shape (n, F).
    """
    curves = np.asarray(losses, dtype=np.float64)
    judged = np.array([unseen_loss(row, []) for row in np.asarray(fresh, dtype=np.float64)])
    return _worth(curves, np.repeat(judged[:, None], curves.shape[1], axis=1), "fresh")


def _worth(curves: np.ndarray, judged: np.ndarray, judged_by: str) -> pd.DataFrame:
    """Compare fitnesses with what judges each of them, shape (n, S)."""
    rows = []
    for epochs in range(1, curves.shape[2] + 1):
        for name in FITNESS.ours:
            rule = of_settings(FITNESS, name, None)
            fitness = np.array([[rule.of(losses) for losses in network] for network in curves[:, :, :epochs].tolist()])
            taus = [agreement(fitness[:, seed], judged[:, seed]) for seed in range(judged.shape[1])]
            known, part = [tau for tau in taus if tau is not None], icc(fitness)
            row = {"epochs": epochs, "rule": name, "one_seed": rounded(float(np.mean(known))) if known else None}
            rows.append(row | {"judged_by": judged_by} | ({} if part is None else part.columns("icc")))
    return pd.DataFrame(rows, columns=list(BY_EPOCHS)).astype(BY_EPOCHS)
