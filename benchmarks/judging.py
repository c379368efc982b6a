"""The networks of a table as its searches meet them, and the judge of those that are handed over."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from benchmarks.written import interval
from tacevo.api.space_tables import SpaceTable as Opened
from tacevo.profile import Admitted
from tacevo.randomness import stream
from tacevo.records import Rejection
from tacevo.results.judged_loss import fresh_losses, judged_loss, log_loss
from tacevo.results.table_records import SpaceTable
from tacevo.training.full import FullTraining


class Visit(NamedTuple):
    """A network that a search trains for the first time."""

    #: Its row in the table.
    network: int
    #: Its lowest validation loss.
    loss: float
    #: Row of the recorded seed.
    seed: int


class Handed(NamedTuple):
    """A network that a search hands over."""

    network: int
    #: Rows of the recorded seeds that chose it, which do not judge it; at least one recorded seed is left.
    seen: tuple[int, ...]


class Space:
    """What the table knows of each network."""

    def __init__(self, table: SpaceTable) -> None:
        self.table, self.opened = table, Opened(table)
        seeds, epochs = range(len(table.header.seeds)), table.header.settings.training.epochs
        verdicts = [[table.verdicts.get((row, seed)) for seed in seeds] for row in range(len(table.networks))]
        lost = (math.inf,) * epochs
        #: The validation loss, by network, seed, and number of epochs less one; infinite where a training failed.
        self.losses = np.array(
            [
                [one.training.validation_losses if isinstance(one, FullTraining) else lost for one in row]
                for row in verdicts
            ]
        )
        #: The lowest so far.
        self.lowest = np.minimum.accumulate(self.losses, axis=2)
        #: The test loss, by network and seed; not a number where a training failed.
        self.tests = np.array(
            [[table.test_loss(row, seed) for seed in seeds] for row in range(len(verdicts))], dtype=float
        )
        self.rows = {network.sha256: row for row, network in enumerate(table.networks)}
        #: What the gate says of an answer, by its text: searches have most answers in common.
        self.admitted: dict[str, Admitted | Rejection] = {}

    def visit(self, network: int, seed: int, epochs: int) -> Visit:
        """Train a network: look up what it has after so many epochs under a recorded seed."""
        return Visit(network, float(self.lowest[network, seed, epochs - 1]), seed)

    def drawn(self, seed: int) -> list[int]:
        """Draw a recorded seed for each network, for a search that does not draw them itself."""
        drawn: list[int] = stream(seed, "reach", "noise").integers(self.lowest.shape[1], size=len(self.rows)).tolist()
        return drawn


class Mean(NamedTuple):
    """A mean of logarithms, its standard error, and what it is of."""

    value: float
    error: float
    searches: int
    networks: int


def mean(space: Space, handed: Sequence[Handed], against: Sequence[Handed] = (), *, paired: bool = False) -> Mean:
    """Return the mean log test loss of what searches handed over, less that of others.

    Where they are `paired`, the searches of both have the same luck one by one, so their differences vary less. The
    error is of the searches, and of the training seeds that judge, those of `judged_loss`: searches which
    hand the same network over share its judges, so that many searches do not make them more. The noise of a seed is
    taken as that of the networks here, of each under the seeds of which some judge it. No error is known where
    a loss is not finite, since a training failed, or since a network is perfect.
    """
    fresh, cells = fresh_losses(space.table), Counter[tuple[int, int]]()
    losses = [
        np.array([judged_loss(space.table, one.network, one.seen) for one in group])
        for group in (handed, against)
        if group
    ]
    value = sum(sign * float(own.mean()) for sign, own in zip((1, -1), losses, strict=False))
    if not np.isfinite(np.concatenate(losses)).all():
        return Mean(value, math.nan, len(handed), len({one.network for one in handed}))
    varied = [losses[0] - losses[1]] if paired else losses
    variance = sum(float(np.var(each, ddof=1)) / len(each) for each in varied)
    for sign, group in zip((1, -1), (handed, against), strict=True):
        for one in group:
            if one.network in fresh:
                left = [*range(len(fresh[one.network]))]
            else:
                left = [seed for seed in range(space.tests.shape[1]) if seed not in one.seen]
            for seed in left:
                cells[one.network, seed] += sign / len(left) / len(group)  # type: ignore[assignment]
    networks = sorted({network for network, _ in cells})
    judging = [fresh.get(network, space.tests[network]) for network in networks]
    noise = float(np.mean([np.var([log_loss(loss) for loss in each], ddof=1) for each in judging]))
    error = math.sqrt(variance + noise * sum(weight**2 for weight in cells.values()))
    return Mean(value, error, len(handed), len({one.network for one in handed}))


def written(one: Mean) -> str:
    """Write a geometric mean, or a ratio of two, with its 95 % interval (normal)."""
    width = float(norm.ppf(0.975)) * one.error
    return interval(math.exp(one.value), math.exp(one.value - width), math.exp(one.value + width), 3)


def p_value(one: Mean) -> float:
    """Return the two-sided p of a difference that is 0 by the null hypothesis (normal)."""
    same = one.error < 1e-9  # but for the last bits: the same networks, judged by the same seeds
    if same or math.isnan(one.error):  # without an error nothing is known
        return 1.0
    return 2 * float(norm.sf(abs(one.value / one.error)))


def of_budget(found: Mapping[str, Any], number: int) -> list[Handed]:
    """Return what the searches of a way handed over after the budget of a number."""
    return [Handed(search[number][0], (search[number][1],)) for search in found["searches"]]
