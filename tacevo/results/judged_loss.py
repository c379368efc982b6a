"""How good a network of a table is: the mean logarithm of its test losses under seeds that did not choose it."""

import math
from collections.abc import Collection, Mapping, Sequence

from tacevo.results.table_records import SpaceTable
from tacevo.rounding import rounded


def log_loss(loss: float) -> float:
    """Return the logarithm of a loss of 0 or more: minus infinity of 0, which a perfect network has."""
    return math.log(loss) if loss > 0 else -math.inf


def mean_log_loss(losses: Collection[float]) -> float:
    """Return the mean of the logarithms of one loss or more, each 0 or more; minus infinity where one is 0."""
    return math.fsum(map(log_loss, losses)) / len(losses)


def fresh_losses(table: SpaceTable) -> Mapping[int, Sequence[float]]:
    """Return the test losses of each network that the judge trained with every fresh seed, by its row in the table.

    Without any where the table has no judge.
    """
    return {} if table.judge is None else table.judge.test_losses


def judged_loss(table: SpaceTable, network: int, seen: Collection[int]) -> float:
    """Judge a network by the seeds that did not choose it.

    Args:
        table: of the network.
        network: its row.
        seen: rows of the recorded seeds that whoever chose it has looked at; one is left, or the judge has the network.

    Returns:
        The mean logarithm of its test losses, to 9 significant digits: under the judge's fresh seeds where the judge
        trained it with each of them, or else under the other recorded seeds; infinite where the gate refused the
        network, or its training failed with one of these.
    """
    if network in (fresh := fresh_losses(table)):
        return rounded(mean_log_loss(fresh[network]))
    left = [seed for seed in range(len(table.header.seeds)) if seed not in seen]
    losses = [loss for seed in left if (loss := table.test_loss(network, seed)) is not None]
    return rounded(mean_log_loss(losses)) if len(losses) == len(left) else math.inf
