"""Searches whose probes and trainings are looked up in the table of a space (data=table)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacevo.config.schema import RunConfig
from tacevo.data.dataset import Dataset
from tacevo.errors import CacheMissError, ConfigError
from tacevo.randomness import stream
from tacevo.records import Json, Limits, Rejection, Training, to_json
from tacevo.results.space_table import SpaceTable, read_table
from tacevo.sandbox.client import Finished, Frame, Score
from tacevo.storage.store import Store
from tacevo.training.evaluation import Evaluator, Examples, Setting

#: What a run's trainings must have in common with those of its table, as keys of the configuration.
_SHARED = (
    "data.image_size",
    "llm.space",
    "training.batch_size",
    "training.learning_rate",
    "training.device",
    "training.precision",
    "numerics.kind",
    "gate.max_parameters",
    "gate.max_flops",
    "gate.max_modules",
)


def table_of(config: RunConfig) -> SpaceTable:
    """Read the table that a configuration with data=table names, and check that its rows are what the run asks for.

    Raises:
        BundleError: as `read_table`.
        ConfigError: the table is of other settings, or of fewer epochs.
    """
    table = read_table(Path(config.data.root or ""))
    made = table.header.settings
    for key in _SHARED:
        ours, theirs = (_value(each, key) for each in (config, made))
        if ours != theirs:
            expected = f"{to_json(theirs)}, as in the table {table.path}"
            raise ConfigError(str(to_json(ours)), place=key, expected=expected)
    if config.training.epochs > made.training.epochs:
        expected = f"at most {made.training.epochs}, the epochs of the table {table.path}"
        raise ConfigError(str(config.training.epochs), place="training.epochs", expected=expected)
    return table


def _value(config: RunConfig, key: str) -> object:
    group, _, name = key.partition(".")
    return getattr(getattr(config, group), name)


def data_of(table: SpaceTable) -> Dataset:
    """Return the data set of a table without its images; the table's digest is its fingerprint."""
    no_rows = np.zeros(0, np.int64)
    return Dataset(
        facts=replace(table.header.data, fingerprint=table.digest),
        images=table.path,
        targets=no_rows,
        train=no_rows,
        validation=no_rows,
        test=no_rows,
        mean=(),
        deviation=(),
        offset=(),
        scale=(),
    )


class Probes:
    """Answers probes as the sandbox does, and nothing else."""

    def __init__(self, table: SpaceTable) -> None:
        self._table = table

    def __call__(
        self, entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None
    ) -> Finished:
        """Answer with the recorded profile, or with why the network was refused."""
        assert entry == "probe"  # trainings are looked up without a job
        assert isinstance(header, dict)
        network = self._table.networks[_row(self._table, str(header["source"]))]
        answer = {"profile": network.profile} if network.rejection is None else {"rejection": network.rejection}
        return Finished((Frame(to_json(answer), b""),))


class LookedUp(Evaluator):
    """The trainings of a search, each the beginning of a recorded one.

    Which recorded seed stands for a training seed is drawn for each source: noise is independent between networks, and
    equal sources share one. `numbered` are the run's training seeds of the first numbers, as many as the table has:
    those of one candidate are different recorded ones. The digests are those of the whole recorded training.
    """

    def __init__(
        self,
        table: SpaceTable,
        numbered: Sequence[int],
        *,
        store: Store,
        setting: Setting,
        examples: Examples,
        rules: int,
    ) -> None:
        super().__init__(run=Probes(table), store=store, setting=setting, examples=examples, rules=rules)
        self._table, self._numbered = table, numbered

    def _train(self, data: Examples, source: str, seed: int) -> Training | Rejection:
        row = _row(self._table, source)
        verdict = self._table.verdicts[row, self._drawn(source, seed)]
        if isinstance(verdict, Rejection):
            return verdict
        epochs, full = self._setting.recipe.epochs, verdict.training
        return replace(full, train_losses=full.train_losses[:epochs], validation_losses=full.validation_losses[:epochs])

    def _drawn(self, source: str, seed: int) -> int:
        """Draw the row of the recorded seed."""
        count, sha256 = len(self._numbered), self._table.networks[_row(self._table, source)].sha256
        if seed in self._numbered:
            order = stream(self._numbered[0], "table", sha256).permutation(count)
            return int(order[self._numbered.index(seed)])
        return int(stream(seed, "table", sha256).integers(count))


def _row(table: SpaceTable, source: str) -> int:
    row = table.by_source.get(source)
    if row is None:
        raise CacheMissError(
            f"another one: {source[:200]!r}", place=str(table.path), expected="a network of the table's space"
        )
    return row
