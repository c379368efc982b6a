"""The table of a space, as DataFrames."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.statistics.spaces import BY_EPOCHS, regret, worth_by_epochs
from tacevo.api import frames
from tacevo.errors import RunError
from tacevo.evolution.descriptors import describe
from tacevo.records import Kind, Rejection
from tacevo.results.space_table import SpaceTable as Rows
from tacevo.results.space_table import TableNetwork, read_table
from tacevo.training.full import FullTraining

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from tacevo.api.runs import Run


class Regret(NamedTuple):
    """How far the network that a search found is from the best of its space."""

    #: Row of its fittest elite.
    network: int
    #: Its mean test loss over the seeds, less the lowest of all networks.
    loss: float
    #: By that mean, from 1.
    rank: int


def open_table(path: str | os.PathLike[str]) -> SpaceTable:
    """Open the table of a space, which `tacevo tabulate` writes; `tacevo replay FILE` verifies more of it.

    Raises:
        BundleError: it is damaged, or another file.
    """
    return SpaceTable(read_table(Path(path)))


class SpaceTable:
    """Every network of a closed space, trained fully with each of some seeds."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __repr__(self) -> str:
        """Say what it is of."""
        return f"<{self._rows.name}>"

    @property
    def digest(self) -> str:
        """The SHA-256 of its manifest, which stands for all of it."""
        return self._rows.digest

    @property
    def is_made_up(self) -> bool:
        """Whether nothing was trained, and no claim can rest on it."""
        return self._rows.header.made_up

    @property
    def networks(self) -> pd.DataFrame:
        """A row a network, the task's baseline first, which has no genome; columns: `frames.TABLE_NETWORKS`."""
        return frames.frame(map(_network, range(len(self._rows.networks)), self._rows.networks), frames.TABLE_NETWORKS)

    @property
    def trainings(self) -> pd.DataFrame:
        """A row a network, seed and epoch; columns: `frames.TABLE_TRAININGS`."""
        return frames.frame(self._epochs(), frames.TABLE_TRAININGS)

    @property
    def scores(self) -> pd.DataFrame:
        """A row a network and seed, a column a test metric, as `Study.scores`; columns: `frames.TABLE_SCORES`."""
        full = [row.full for row in self._rows.trainings if row.full is not None]
        metrics = dict.fromkeys((name for training in full for name in training.metrics), "float64")
        return frames.frame(self._scored(), {**frames.TABLE_SCORES, **metrics})

    @property
    def worth(self) -> pd.DataFrame:
        """What a fitness is worth after each number of epochs, by each rule; columns: `BY_EPOCHS`.

        The ICC of one training, and Kendall's tau with the test loss at the best epoch under other seeds; networks that
        failed are left out. Without rows where the table has one seed.
        """
        _, losses, scores = self._sound()
        rows = worth_by_epochs(losses, scores)
        return frames.frame([], BY_EPOCHS) if rows is None else rows

    def regret(self, run: Run) -> Regret:
        """Compare the fittest elite of a run with all networks, by their test loss.

        Raises:
            RunError: the elite is not a network of this table, or failed.
        """
        best = str(run.elites["id"].iloc[0])
        source = run.candidates.loc[best, "source"]
        rows, _, scores = self._sound()
        own = [place for place, row in enumerate(rows) if self._rows.networks[row].sha256 == source]
        if not own:
            got = f"{best}, which is none or failed"
            raise RunError(got, place=str(self._rows.path), expected="a trained network of this table")
        loss, rank = regret(scores, own[0])
        return Regret(network=rows[own[0]], loss=loss, rank=rank)

    def _sound(self) -> tuple[list[int], NDArray[np.float64], NDArray[np.float64]]:
        """Return the networks that trained with every seed, their losses (n, S, E) and test losses (n, S)."""
        header, verdicts = self._rows.header, self._rows.verdicts
        metric = "cross_entropy" if header.data.kind is Kind.classification else "mse"
        seeds = range(len(header.seeds))
        trained = {
            row: full
            for row in range(len(self._rows.networks))
            if len(full := [one for s in seeds if isinstance(one := verdicts.get((row, s)), FullTraining)])
            == len(seeds)
        }
        losses = np.array([[one.training.validation_losses for one in full] for full in trained.values()])
        return list(trained), losses, np.array([[one.metrics[metric] for one in full] for full in trained.values()])

    def _epochs(self) -> Iterator[dict[str, Any]]:
        for row in self._rows.trainings:
            if row.full is None:
                continue
            pairs = zip(row.full.training.train_losses, row.full.training.validation_losses, strict=True)
            for epoch, (train, validation) in enumerate(pairs, start=1):
                yield {
                    "network": row.network,
                    "seed": row.seed,
                    "epoch": epoch,
                    "train_loss": train,
                    "validation_loss": validation,
                }

    def _scored(self) -> Iterator[dict[str, Any]]:
        for row in self._rows.trainings:
            verdict, place = row.verdict, {"network": row.network, "seed": row.seed}
            if isinstance(verdict, Rejection):
                yield {**place, "failed": verdict.reason.value}
            else:
                yield {
                    **place,
                    "epoch": verdict.epoch,
                    "validation_loss": verdict.validation_loss,
                    **verdict.metrics,
                }


def _network(row: int, network: TableNetwork) -> dict[str, Any]:
    values = {"network": row, "source": network.sha256, **(network.genome or {})}
    if network.rejection is not None:
        return {**values, "refused": network.rejection.reason.value}
    assert network.profile is not None  # as reading checks
    descriptor = describe(network.profile)
    return {
        **values,
        "parameters": network.profile.parameters,
        "flops": network.profile.flops,
        "arch_div": descriptor.arch_div,
        "eff_ratio": descriptor.eff_ratio,
    }
