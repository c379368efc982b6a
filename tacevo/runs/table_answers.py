"""Searches whose probes and trainings are looked up in the table of a space (data=table)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tacevo.config.schema import RunConfig
from tacevo.data.dataset import Dataset
from tacevo.errors import CacheMissError, ConfigError
from tacevo.parts.source import Catalogue
from tacevo.randomness import stream
from tacevo.records import Json, Limits, Rejection, Task, Training, to_json
from tacevo.results.space_table import read_table
from tacevo.results.table_checks import check_like_today
from tacevo.results.table_records import DECISIVE, SpaceTable, value_of
from tacevo.runs.progress import Progress
from tacevo.runs.seeds import noise_seed, training_seed
from tacevo.sandbox.client import Finished, Frame, RunJob, Score
from tacevo.storage.canonical import canonical
from tacevo.storage.store import Store
from tacevo.training.evaluation import Evaluator, Examples, Setting


def table_of(config: RunConfig) -> SpaceTable:
    """Read the table that a configuration with data=table names, and check that its rows are what the run asks for.

    Raises:
        BundleError: as `read_table`.
        ConfigError: the table is of other settings or rules, or of fewer epochs.
    """
    table = read_table(Path(config.data.root or ""))
    made = table.header.settings
    if config.llm.space is None:
        raise ConfigError(
            f"llm={config.llm.provider}, which is not bound to a space",
            place="llm",
            expected=f"the grammar within the space of the table {table.path}",
            remedy="set llm=grammar_space",
        )
    for key in DECISIVE:
        ours, theirs = (value_of(each, key) for each in (config, made))
        if ours != theirs:
            expected = f"{canonical(to_json(theirs))}, as in the table {table.path}"
            raise ConfigError(canonical(to_json(ours)), place=key, expected=expected)
    check_like_today(table)
    _check_most("training.epochs", config.training.epochs, made.training.epochs, f"the epochs of {table.path}")
    if config.llm.slip_rate:
        expected = "0 with data=table, which has no networks with mistakes"
        raise ConfigError(str(config.llm.slip_rate), place="llm.slip_rate", expected=expected)
    return table


def check_fresh(config: RunConfig, seeds: int) -> None:
    """Check that a table has so many seeds for a noise run, beside those that the search has seen.

    Raises:
        ConfigError: it has fewer; or as `table_of`.
    """
    table = table_of(config)
    left = len(table.header.seeds) - 1
    what = f"those of the {len(table.header.seeds)} of {table.path} that the search has not seen"
    remedy = f"set seeds={left}" if left else "a noise run needs a table of more seeds, and a search in that"
    _check_most("seeds", seeds, left, what, remedy)


def _check_most(key: str, value: int, most: int, what: str, remedy: str = "") -> None:
    if value > most:
        raise ConfigError(str(value), place=key, expected=f"at most {most}, {what}", remedy=remedy)


@dataclass(frozen=True, slots=True)
class LookedUp:
    """Probes and trainings are those of a table (see `tacevo.runs.datasets.Answering`)."""

    config: RunConfig

    @property
    def run(self) -> RunJob:
        """The function that answers probes from the table; it and all others raise the errors of `table_of`."""
        return probes_of(table_of(self.config))

    @property
    def evaluator(self) -> Callable[..., Evaluator]:
        """The function that makes the evaluator of a search."""
        return partial(_LookedUp, table_of(self.config), self.config.seed)

    def data(self, view: Progress, catalogue: Catalogue | None) -> Dataset:
        """Return the data set of the table without its images; the table's digest is its fingerprint."""
        table, no_rows = table_of(self.config), np.zeros(0, np.int64)
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

    def trivial(self, task: Task, data: Dataset) -> float:
        """Return the trivial loss that the table recorded."""
        return table_of(self.config).header.trivial


def probes_of(table: SpaceTable) -> RunJob:
    """Return what answers probes as the sandbox does, with recorded profiles or refusals, and nothing else."""

    def answer(entry: str, header: Json, payload: bytes, limits: Limits, score: Score | None = None) -> Finished:
        assert entry == "probe"  # trainings are looked up without a job
        assert isinstance(header, dict)
        network = table.networks[_row(table, str(header["source"]))]
        said = {"profile": network.profile} if network.rejection is None else {"rejection": network.rejection}
        return Finished((Frame(to_json(said), b""),))

    return answer


def recorded_seeds(table: SpaceTable, seed: int, source: str) -> dict[int, int]:
    """Return which recorded seed stands for which training seed of a run, for one of its networks.

    It is drawn for each source: noise is independent between networks, and equal sources share one. There are as many
    training seeds as the table has: that of the run's search, and then those of its noise runs. They are drawn without
    replacement, so a re-estimate is never of a training that the search has seen.

    Args:
        table: in which the run looks its trainings up.
        seed: of the run.
        source: the network's source, of which the table has a row.

    Returns:
        The row of the recorded seed in the table's header, by training seed; the search's first.
    """
    others = range(len(table.header.seeds) - 1)
    numbered = [training_seed(seed, 0), *(noise_seed(seed, number) for number in others)]
    sha256 = table.networks[_row(table, source)].sha256
    order = stream(numbered[0], "table", sha256).permutation(len(numbered))
    return dict(zip(numbered, order.tolist(), strict=True))


class _LookedUp(Evaluator):
    """The trainings of a search, each the beginning of a recorded one (see `recorded_seeds`).

    The digests are those of the whole recorded training.
    """

    def __init__(
        self,
        table: SpaceTable,
        seed: int,
        *,
        run: RunJob,
        store: Store,
        setting: Setting,
        examples: Examples,
        rules: int,
    ) -> None:
        super().__init__(run=run, store=store, setting=setting, examples=examples, rules=rules)
        self._table, self._seed = table, seed

    def _train(self, data: Examples, source: str, seed: int) -> Training | Rejection:
        row = _row(self._table, source)
        verdict = self._table.verdicts[row, recorded_seeds(self._table, self._seed, source)[seed]]
        if isinstance(verdict, Rejection):
            return verdict
        epochs, full = self._setting.recipe.epochs, verdict.training
        return replace(full, train_losses=full.train_losses[:epochs], validation_losses=full.validation_losses[:epochs])


def _row(table: SpaceTable, source: str) -> int:
    row = table.by_source.get(source)
    if row is None:
        raise CacheMissError(
            f"another one: {source[:200]!r}", place=str(table.path), expected="a network of the table's space"
        )
    return row
