"""What the project's table can tell, as docs/table.md prints it: its genes, its noise, and the floor of draws.

    python -m benchmarks.space

No network is judged by a seed that chose it (`analysis.statistics.spaces`). A minute of a core.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.statistics.seed_noise import agreement, deviations, icc, reliability, shrunken
from analysis.statistics.spaces import best_unseen_loss, worth_by_epochs
from benchmarks.judging import Space, mean
from benchmarks.reach import at_random, handed_over
from benchmarks.written import interval
from tacevo.results.gene_model import put_first
from tacevo.results.judged_loss import fresh_losses, mean_log_loss
from tacevo.results.space_table import read_table

#: The two genes that matter, with their better values.
GOOD = {"down": "max", "norm": "batch"}

#: A loss within this factor of the best one's is as good.
AS_GOOD = 1.1

#: Epochs whose fitness is looked at.
EPOCHS = (1, 3, 5, 10, 20)

#: Trainings of ten epochs after which draws hand a network over, and how often each is drawn.
DRAWN, REPEATS = (5, 9, 20, 40, 60, 100), 2000


def worths(space: Space) -> Iterator[str]:
    """Yield the rows of ICC and tau by recorded seeds: whole space, and the quarter with both good values."""
    groups = [np.arange(len(space.tests)), good_of(space)]
    frames = [worth_by_epochs(space.losses[rows], space.tests[rows]) for rows in groups]
    known = [frame for frame in frames if frame is not None]
    assert len(known) == len(groups)
    yield from rows_of(known)


def judged(space: Space) -> Iterator[str]:
    """Yield what the fresh seeds of the table's judge say of its networks: their level, their noise, ICC and tau."""
    fresh = fresh_losses(space.table)
    if not fresh:
        yield "the table has no judge"
        return
    tests = np.array([*fresh.values()])
    between, within = deviations(np.log(tests))
    seeds, means, best = tests.shape[1], np.log(tests).mean(axis=1), best_unseen_loss(tests)
    yield f"{len(tests)} networks, {seeds} fresh seeds each: geometric mean {np.exp(means.mean()):.3f}"
    yield f"deviation between networks {between:.2f}, between seeds {within:.2f}"
    part = icc(tests)
    assert part is not None
    yield f"ICC of a test loss {interval(part.estimate, part.low, part.high)}"
    yield f"reliability of a mean of {seeds} seeds {reliability(np.log(tests)):.2f}"
    recorded = [mean_log_loss(space.tests[row].tolist()) for row in fresh]
    yield f"tau of that mean with the mean of the recorded seeds {agreement(recorded, means):.2f}"
    yield f"best by all seeds but one, judged by that one: {np.exp(best):.3f}"
    levels = shrunken(np.log(tests))
    good = (levels <= levels.min() + np.log(AS_GOOD)).sum()
    yield f"within {AS_GOOD - 1:.0%} of the best, by means shrunk to that of all: {good}"
    yield from rows_of([space.opened.worth])


def rows_of(worths: Sequence[pd.DataFrame]) -> Iterator[str]:
    """Yield a row for each number of epochs: ICC and then tau, each by `last` and `lowest`, of each frame."""
    frames = [frame.set_index(["epochs", "rule"]) for frame in worths]
    for epochs in EPOCHS:
        shown = [
            f"{frame.loc[(epochs, rule), value]:.2f}"
            for value in ("icc", "one_seed")
            for rule in ("last", "lowest")
            for frame in frames
        ]
        yield f"| {epochs} | {' | '.join(shown)} |"


def good_of(space: Space) -> NDArray[np.intp]:
    """Return the rows of the networks with both good values."""
    networks = space.opened.networks
    return np.flatnonzero(np.all([networks[gene] == value for gene, value in GOOD.items()], axis=0))


def explained(logs: NDArray[np.float64], groups: pd.Series) -> float:
    """Return the part of the variance of networks' mean log losses, shape (n,), that lies between groups of them."""
    means = pd.Series(logs).groupby(groups.to_numpy()).transform("mean")
    return float(np.var(means) / np.var(logs))


def figures(space: Space) -> Iterator[str]:
    """Yield a sentence a figure."""
    networks, logs = space.opened.networks, np.log(space.tests)
    means, cells = logs.mean(axis=1), networks["down"] + ", " + networks["norm"]
    genes = networks["down"].notna().to_numpy()  # all but the baseline's file
    yield f"two genes explain {explained(means[genes], cells[genes]):.2f} of the variance of the mean log test loss"
    levels = pd.Series(means[genes]).groupby(cells[genes].to_numpy()).mean()
    yield "geometric mean test loss: " + ", ".join(f"{name} {np.exp(level):.3f}" for name, level in levels.items())
    good = good_of(space)
    order = np.argsort(means)
    hold = [f"{np.isin(order[:best], good).sum()} of the best {best}" for best in (8, 38)]
    yield f"the {len(good)} networks with both hold {' and '.join(hold)}"
    whole, quarter = icc(space.tests), icc(space.tests[good])
    assert whole is not None
    assert quarter is not None
    yield f"ICC of a test loss: {whole.estimate:.2f}, among these {quarter.estimate:.2f}"
    between, within = deviations(logs[good])
    yield f"among these: deviation between networks {between:.2f}, between seeds {within:.2f}"
    yield f"reliability of a mean of {logs.shape[1]} seeds {reliability(logs[good]):.2f}"
    for name, rows in (("all", order), ("those with both", good)):
        best = np.exp(best_unseen_loss(space.tests[rows]))
        yield f"best by all seeds but one, judged by that one, of {name}: {best:.3f}"
    yield f"the lowest mean of all seeds, which is luck: {space.tests.mean(axis=1).min():.3f}"
    yield f"geometric mean of all: {np.exp(means.mean()):.3f}, of those with both {np.exp(means[good].mean()):.3f}"
    first = put_first(space.table, 96)
    yield f"of the {len(first)} that the model of the genes puts first {np.isin(first, good).sum()} have both"
    epochs = np.argmin([one.full.training.validation_losses for one in space.table.trainings if one.full], axis=1)
    last = (epochs >= 0.9 * space.lowest.shape[2]).mean()
    yield f"trainings that are best in the last tenth of their epochs: {last:.0%}"


def draws(space: Space) -> Iterator[str]:
    """Yield what draws hand over after so many trainings of ten epochs."""
    for count in DRAWN:
        handed = [handed_over(at_random(space, seed, count, 10), 10, (10 * count,))[0] for seed in range(REPEATS)]
        yield f"| {count} | {np.exp(mean(space, handed).value):.3f} |"


def ideal_stop(space: Space) -> str:
    """Say how often draws hand a network of the best twentieth over, as a figure that is gone from here counted it.

    Of the five fittest of 100 networks the one with the lowest mean loss of two more trainings is handed over: at the
    end, or, with an ideal stop, after whichever training it would be good. The test losses are of all seeds.
    """
    tests, ends, stops = space.tests.mean(axis=1), 0, 0
    good = tests <= np.quantile(tests, 0.05)
    again = [[np.delete(seeds, own).mean() for own in range(len(seeds))] for seeds in space.lowest[:, :, 9]]
    for seed in range(REPEATS // 4):
        visits, found = at_random(space, seed, 100, 10), []
        for count in range(1, len(visits) + 1):
            fittest = sorted(visits[:count], key=lambda visit: visit.loss)[:5]
            found.append(good[min(fittest, key=lambda visit: again[visit.network][visit.seed]).network])
        ends, stops = ends + found[-1], stops + any(found)
    shares = [f"{4 * count / REPEATS:.0%}" for count in (ends, stops)]
    return f"of 100 draws one of the best twentieth is handed over in {shares[0]}, by an ideal stop in {shares[1]}"


def main() -> None:
    """Print all of it."""
    space = Space(read_table(Path("cache/tables/grating-space.zip")))
    for lines in (worths(space), figures(space), judged(space), draws(space), [ideal_stop(space)]):
        print("\n".join(lines), end="\n\n", flush=True)


if __name__ == "__main__":
    main()
