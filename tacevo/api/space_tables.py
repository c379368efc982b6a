"""The table of a space, as DataFrames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.statistics.spaces import BY_EPOCHS, best_unseen_loss, unseen_loss, worth_by_epochs, worth_by_judge
from analysis.sweeps.rejections import rejection_rates
from tacevo.api import frames
from tacevo.api.runs import Run
from tacevo.api.space_problems import SpaceProblem, seeds_seen, whole
from tacevo.bundles.format import STORE
from tacevo.config.identity import twins_of
from tacevo.errors import BundleError, ConfigError, RunError
from tacevo.evolution.descriptors import describe
from tacevo.records import Rejection
from tacevo.results.judged_loss import fresh_losses, judged_loss
from tacevo.results.space_table import read_table
from tacevo.results.table_records import SpaceTable as Rows
from tacevo.results.table_records import TableNetwork, TableTraining
from tacevo.rounding import rounded
from tacevo.runs.seeds import training_seed
from tacevo.runs.table_answers import recorded_seeds
from tacevo.storage.zipfiles import names_in
from tacevo.training.full import FullTraining

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from tacevo.api.sweeps import Sweep


class Regret(NamedTuple):
    """How much worse the network that a search found is than the best of its space, by seeds that chose neither."""

    #: Row of its fittest elite.
    network: int
    #: The network's mean log test loss (`SpaceTable.unseen_loss`), less that of the best network, likewise: 0.1 is a
    #: loss that is a tenth higher. It can lie below 0.
    loss: float
    #: The network's rank, from 1: among the judged networks, or, where no judge has it, among all by the same seeds.
    rank: int


def open_table(path: str | os.PathLike[str]) -> SpaceTable:
    """Open the table of a space, which `tacevo tabulate` writes; `tacevo replay FILE` verifies more of it.

    Raises:
        BundleError: it is damaged, or another file, a directory among them.
        ConfigError: this is not a path.
    """
    if not isinstance(path, str | os.PathLike):
        known = {SpaceTable: "it is open already", Run: "a run is not a table"}
        remedy = next((words for kind, words in known.items() if isinstance(path, kind)), "")
        raise ConfigError(repr(path), place="path", expected=_TABLE, remedy=remedy)
    place = Path(path)
    is_bundle = STORE in (names_in(place) or ())
    if place.is_dir() or is_bundle:
        kinds = {place / "sweep.json": "the directory of a sweep", place / "run.json": "the directory of a run"}
        found = [words for file, words in kinds.items() if file.exists()]
        got = "the bundle of a run or a sweep" if is_bundle else next(iter(found), "a directory")
        remedy = f"`tacevo.open({str(path)!r})` opens it" if is_bundle or found else "name the file in it"
        raise BundleError(got, place=str(path), expected=_TABLE, remedy=remedy)
    return SpaceTable(read_table(place))


#: The argument of `open_table`, as error messages name it.
_TABLE = "the file of a table, as `tacevo tabulate` writes it"


class SpaceTable:
    """Every network of a closed space, trained fully with each of some seeds."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows

    def __repr__(self) -> str:
        """Say what it is of, and what a file alone cannot show."""
        claimed = "" if self.is_made_up else "; profiles as the file claims: `tacevo replay FILE` measures them"
        return f"<{self._rows.name}{claimed}>"

    @property
    def digest(self) -> str:
        """The SHA-256 of its rows and what decides them; searches have it as the fingerprint of their data."""
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
        return _scores(self._rows.trainings)

    @property
    def judge(self) -> pd.DataFrame:
        """A row a network and fresh seed of the judge, in the judge's order; columns as of `scores`.

        Without rows where the table has no judge (`tacevo judge`).
        """
        rows = () if self._rows.judge is None else self._rows.judge.trainings
        return _scores(rows)

    @property
    def worth(self) -> pd.DataFrame:
        """The worth of a fitness after each number of epochs, by each rule (`worth_of`).

        Over the judge's networks where the table has a judge, or else over all; `judged_by` says which.
        """
        return self.worth_of()

    def worth_of(self, **genes: bool | float | str) -> pd.DataFrame:
        """Return the worth of a fitness among the networks of some genes, after each number of epochs, by each rule.

        The ICC of one training, and Kendall's tau of the fitness under one seed with the mean log test loss under seeds
        that it has not seen, the mean over the recorded seeds. Where the judge has two or more of the networks, both
        are among these alone, and its seeds are those that judge (`judged_by` is `fresh`); or else both are among all
        of the networks, and all other recorded seeds judge (`recorded`). Networks that failed are left out. Without
        rows where one seed, or one network, is all.

        Args:
            genes: a value of each, such as `down="max", norm="batch"`; none for all.

        Returns:
            Columns: `BY_EPOCHS`.

        Raises:
            ConfigError: the space has no such gene, or fewer than two of its networks have these values.
        """
        chosen = self._with_genes(genes)
        if self._rows.judge is not None:
            rows = [row for row in self._fresh if row in self._tests and chosen(row)]
            if len(rows) > 1:
                return worth_by_judge(self._losses(rows), [self._fresh[row] for row in rows])
        rows = [row for row in self._tests if chosen(row)]
        if len(rows) < 2 and not genes:
            return frames.frame([], BY_EPOCHS)
        if len(rows) < 2:
            raise ConfigError(f"{genes}", place="genes", expected="values that two networks or more of the table have")
        worth = worth_by_epochs(self._losses(rows), [self._tests[row] for row in rows])
        return frames.frame([], BY_EPOCHS) if worth is None else worth

    def unseen_loss(self, network: int, *, seen: Iterable[int]) -> float:
        """Judge a network by the seeds that did not choose it.

        Args:
            network: its row.
            seen: rows of the recorded seeds that whoever chose it has looked at.

        Returns:
            The mean logarithm of its test loss: under the judge's fresh seeds where the judge trained it with each of
            them, or else under the other recorded seeds. Minus infinity where one of these losses is 0.

        Raises:
            ConfigError: no such network trained with every seed; or one of `seen` is not recorded; or no seed is left,
                and the judge has not the network.
        """
        row = whole(network, "network", 0, len(self._rows.networks) - 1)
        if row not in self._fresh and row not in self._tests:
            raise ConfigError(repr(network), place="network", expected="the row of one that trained with every seed")
        return judged_loss(self._rows, row, seeds_seen(self._rows, row, seen))

    def as_problem(self, *, rule: str = "lowest") -> SpaceProblem:
        """Return the space as a problem to search by ask and tell, for an optimiser of anybody's.

        Args:
            rule: the rule by which a fitness follows from validation losses: `lowest`, `last` or `mean_of_3`.

        Raises:
            BundleError: networks of the space are missing.
            ConfigError: there is no such rule.
        """
        return SpaceProblem(self._rows, rule)

    def regret(self, run: Run) -> Regret:
        """Compare the fittest elite of a run with the best network, by seeds that chose neither (`unseen_loss`).

        The best is the network that all seeds but one choose, judged by that one, the mean over the seeds. Both, and
        the rank, are by the fresh seeds among the judge's networks where the judge trained the elite with each of them,
        or else by recorded seeds among all networks, as of a table without a judge.

        Args:
            run: one that looked its evaluations up in this table, or trained on the data set that it is of.

        Raises:
            RunError: the run is of other data, or has no elite; or that is not a network of this table, or failed.
            ConfigError: it is not an open run; or the table has one seed, which chose, and no judge.
        """
        if not isinstance(run, Run):
            raise _not_open(run, "run", "one run, opened")
        self._check_of(run)
        if run.elites.empty:
            raise RunError("none", place=run.name, expected="at least one elite")
        best = str(run.elites["id"].iloc[0])
        place, expected = f"{run.name}, {best}", f"a network of {self._rows.path} that trained with every seed"
        own = self._by_hash.get(str(run.candidates.loc[best, "source"]))
        if own is None:
            raise RunError("a network that is not in it", place=place, expected=expected)
        if own not in self._tests:
            raise RunError(f"network {own}, which did not", place=place, expected=expected)
        judging, seen = (self._fresh, set[int]()) if own in self._fresh else (self._tests, self._seen(run, own))
        if len(judging[own]) < 2:
            expected = "a table of two seeds or more, or with a judge that has the network"
            raise ConfigError("one", place="seeds", expected=expected)
        losses = {row: unseen_loss(each, seen) for row, each in judging.items()}
        loss, least = losses[own], best_unseen_loss(list(judging.values()))
        rank = 1 + sum(other < loss for other in losses.values())
        return Regret(network=own, loss=0.0 if loss == least else rounded(loss - least), rank=rank)

    def _seen(self, run: Run, network: int) -> set[int]:
        """Return the rows of the recorded seeds by which a run chose a network."""
        seed, seeds = training_seed(run.config.seed, 0), self._rows.header.seeds
        if run.recorded.record.data.fingerprint == self.digest:
            return {recorded_seeds(self._rows, run.config.seed, self._rows.networks[network].source)[seed]}
        return {seeds.index(seed)} if seed in seeds else set()

    def size_and_power(self, sweep: Sweep, *, seeds: int) -> pd.DataFrame:
        """Return how often the tests of `tacevo ablations` reject with so many seeds an arm; columns: `RATES`.

        The finished searches of the sweep are divided into sweeps of `seeds` seeds. An arm compared with itself under
        other seeds gives the size of a test, an arm compared with the sweep's reference its power.

        Raises:
            ConfigError: the sweep has too few seeds for one comparison of an arm with itself; or this is not an open
                sweep, or no number of seeds.
            RunError: a run is not of this table.
        """
        from tacevo.api.sweeps import Sweep  # imports the comparison of arms, which most tables are not opened for

        if not isinstance(sweep, Sweep):
            raise _not_open(sweep, "sweep", "a sweep, opened, whose arms are compared")
        for run in sweep.runs:
            self._check_of(run)
        compared = sweep.collection().ablation
        shared = len(set.intersection(*(set(rows["seed"]) for _, rows in compared.jobs.groupby("arm"))))
        if shared < 4:
            expected = f"a sweep of at least 4 seeds that all arms have, and not of {shared}"
        else:
            expected = f"a whole number from 2 to {shared // 2}, half of the {shared} seeds that all arms have"
        few = ConfigError(repr(seeds), place="seeds", expected=expected)
        if type(seeds) is not int or seeds < 2:
            raise few
        twins = twins_of(compared.requested_reference, compared.twins)
        rates = rejection_rates(
            compared.jobs, seeds=seeds, requested_reference=compared.requested_reference, twins=twins
        )
        if not (rates["arm"] == rates["against"]).any():
            raise few
        return rates

    def _check_of(self, run: Run) -> None:
        """Check that a run looked its evaluations up in this table, or trained on its data set."""
        data, known = run.recorded.record.data.fingerprint, (self.digest, self._rows.header.data.fingerprint)
        if data not in known:
            got, expected = f"one of the fingerprint {data[:12]}", f"a run on {self._rows.path}, or on its data set"
            raise RunError(got, place=run.name, expected=expected)

    @cached_property
    def _by_hash(self) -> dict[str, int]:
        return {network.sha256: row for row, network in enumerate(self._rows.networks)}

    @property
    def _tests(self) -> Mapping[int, Sequence[float]]:
        """The test losses of each network that trained with every recorded seed, by its row."""
        return self._rows.test_losses

    @property
    def _fresh(self) -> Mapping[int, Sequence[float]]:
        """The same by the judge's fresh seeds; empty without a judge."""
        return fresh_losses(self._rows)

    def _losses(self, rows: Sequence[int]) -> NDArray[np.float64]:
        """Return the validation losses of networks that trained with every recorded seed, shape (n, S, E)."""
        verdicts, seeds = self._rows.verdicts, range(len(self._rows.header.seeds))
        full = [[verdicts[row, seed] for seed in seeds] for row in rows]
        curves = [[one.training.validation_losses for one in each if isinstance(one, FullTraining)] for each in full]
        return np.array(curves)

    def _with_genes(self, genes: Mapping[str, bool | float | str]) -> Callable[[int], bool]:
        """Return what answers whether the network of a row has these values."""
        known = {name for network in self._rows.networks for name in network.genome or {}}
        if unknown := sorted(genes.keys() - known):
            raise ConfigError(", ".join(unknown), place="genes", expected=f"of {', '.join(sorted(known))}")
        if not genes:
            return lambda row: True
        return lambda row: genes.items() <= (self._rows.networks[row].genome or {}).items()

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


def _scores(rows: Sequence[TableTraining]) -> pd.DataFrame:
    full = [row.full for row in rows if row.full is not None]
    metrics = dict.fromkeys((name for training in full for name in training.metrics), "float64")
    return frames.frame(map(_scored, rows), {**frames.TABLE_SCORES, **metrics})


def _scored(row: TableTraining) -> dict[str, Any]:
    verdict, columns = row.verdict, {"network": row.network, "seed": row.seed}
    if isinstance(verdict, Rejection):
        return {**columns, "failed": verdict.reason.value}
    return {**columns, "epoch": verdict.epoch, "validation_loss": verdict.validation_loss, **verdict.metrics}


def _not_open(value: object, place: str, expected: str) -> ConfigError:
    """Return the error for what is not an open run or sweep, with the way to one where a path was given."""
    from tacevo.api.sweeps import Sweep

    if isinstance(value, str | os.PathLike):
        remedy = f"open it: tacevo.open({os.fspath(value)!r})"
    elif isinstance(value, Sweep):
        remedy = "ask for each of sweep.runs"
    else:
        remedy = "`tacevo.open(PATH)` opens one"
    return ConfigError(repr(value), place=place, expected=expected, remedy=remedy)


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
