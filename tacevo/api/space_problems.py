"""The table of a space as a problem for anybody's optimiser: what can be chosen, what it gives, and a judge apart."""

import math
import operator
from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

from tacevo.errors import BundleError, ConfigError
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.results.judged_loss import fresh_losses, judged_loss
from tacevo.results.table_records import SpaceTable
from tacevo.text import listed, nearest
from tacevo.training.full import FullTraining

#: A value of a gene.
Value = bool | int | float | str


class Evaluation(NamedTuple):
    """The beginning of a recorded training, and what it cost."""

    #: What an optimiser is to minimise; infinite where the gate refused the network or its training failed.
    fitness: float
    #: The validation loss after each epoch; none of a network that was refused or failed.
    losses: tuple[float, ...]
    #: The epochs trained, and the FLOPs of this training as `search.training_flops` counts them: forward, of all images
    #: that train. Zero where there are no losses.
    epochs: int
    flops: int


class SpaceProblem:
    """A closed space to search by ask and tell: each network is a value of each gene, and each answer is recorded.

    Nothing is drawn at random and nothing is remembered: equal questions have equal answers.
    """

    def __init__(self, table: SpaceTable, rule: str) -> None:
        if not isinstance(rule, str) or rule not in FITNESS.ours:
            raise ConfigError(repr(rule), place="rule", expected=f"one of {', '.join(FITNESS.ours)}")
        self._table, self._fitness = table, of_settings(FITNESS, rule, None)
        settings = table.header.settings
        self._genes = _genes_of(table)
        self._choices = {name: {value: value for value in values} for name, values in self._genes.items()}
        self._rows = {
            tuple(network.genome[name] for name in self._genes): row
            for row, network in enumerate(table.networks)
            if network.genome is not None
        }
        #: How many training seeds are recorded; they are numbered from 0.
        self.seeds: int = len(table.header.seeds)
        #: How many epochs are recorded of each training.
        self.epochs: int = settings.training.epochs

    def __repr__(self) -> str:
        """Say how large it is."""
        return f"<{len(self._rows)} networks by {len(self._genes)} genes, of {self._table.name}>"

    @property
    def genes(self) -> Mapping[str, tuple[Value, ...]]:
        """The choices of each gene, by its name; each combination is a network of the table."""
        return MappingProxyType(self._genes)

    def evaluate(self, genes: Mapping[str, Value], *, seed: int, epochs: int) -> Evaluation:
        """Return what a training of a network gives.

        Args:
            genes: one of its choices for each gene.
            seed: the number of a recorded seed, in [0, `seeds`).
            epochs: how long it trains, in [1, `epochs`].

        Raises:
            ConfigError: a gene is missing or unknown, or has another value than its choices; or there is no such seed,
                or it has not so many epochs.
        """
        row = self._row(genes)
        number = whole(seed, "seed", 0, self.seeds - 1)
        length = whole(epochs, "epochs", 1, self.epochs)
        profile, verdict = self._table.networks[row].profile, self._table.verdicts.get((row, number))
        if profile is None or not isinstance(verdict, FullTraining):
            return Evaluation(math.inf, (), 0, 0)
        losses = verdict.training.validation_losses[:length]
        images = self._table.header.data.counts[0]
        return Evaluation(self._fitness.of(losses), losses, length, images * length * profile.training_flops)

    def judge(self, genes: Mapping[str, Value], *, seen: Iterable[int]) -> float:
        """Return how good a network is by the seeds that did not choose it; lower is better.

        That is `SpaceTable.unseen_loss`: the mean of the logarithm of the test loss, at the epoch of the lowest
        validation loss of a whole training. It is over the fresh seeds of the table's judge where the judge trained the
        network with each of them, or else over all recorded seeds but `seen`; then it is infinite where the network was
        refused or one of these failed.

        Args:
            genes: as `evaluate` takes them.
            seen: the seeds whose evaluations of this network the search knows; at least one is left, or the judge has
                the network.

        Raises:
            ConfigError: as `evaluate`; or no seed is left.
        """
        row = self._row(genes)
        return judged_loss(self._table, row, seeds_seen(self._table, row, seen))

    def _row(self, genes: Mapping[str, Value]) -> int:
        """Find the row of a network by its genes."""
        if not isinstance(genes, Mapping):
            expected = f"a mapping from each gene to its value: {listed(self._genes)}"
            raise ConfigError(repr(genes), place="genes", expected=expected)
        if unknown := [str(name) for name in genes if name not in self._genes]:
            remedy = nearest(unknown[0], self._genes, "")
            raise ConfigError(listed(unknown), place="genes", expected=listed(self._genes), remedy=remedy)
        if missing := [name for name in self._genes if name not in genes]:
            raise ConfigError(f"no {listed(missing)}", place="genes", expected=f"each of {listed(self._genes)}")
        return self._rows[tuple(self._choice(name, genes[name]) for name in self._genes)]

    def _choice(self, name: str, value: Value) -> Value:
        """Return the choice of a gene that equals a value, be it of a type of numpy's."""
        choices = self._choices[name]
        try:
            return choices[value]
        except (KeyError, TypeError):  # of what cannot be hashed, too
            expected = f"one of {', '.join(map(repr, choices))}"
            raise ConfigError(repr(value), place=f"genes.{name}", expected=expected) from None


def _genes_of(table: SpaceTable) -> dict[str, tuple[Value, ...]]:
    """Return the choices of each gene of a table.

    Raises:
        BundleError: it has not each combination of them once.
    """
    space = table.header.settings.llm.space
    if space is None:
        raise BundleError("null", place=f"{table.path}, llm.space", expected="the space that the table is of")
    genes: dict[str, tuple[Value, ...]] = {field.name: getattr(space, field.name) for field in fields(space)}
    found: Collection[Mapping[str, Value]] = [one.genome for one in table.networks if one.genome is not None]
    rows = [tuple(genome.get(name) for name in genes) for genome in found if genome.keys() == genes.keys()]
    lost = len(set(product(*genes.values())) - set(rows))
    if lost or len(found) != space.size:
        got = f"{len(found)} networks with genes, and {lost} combinations without one"
        expected = f"each of the {space.size} combinations of its space once"
        raise BundleError(got, place=str(table.path), expected=expected, remedy="`tacevo tabulate` makes a whole table")
    return genes


def seeds_seen(table: SpaceTable, network: int, seen: Iterable[int]) -> set[int]:
    """Return the rows of the recorded seeds by which a network was chosen.

    Raises:
        ConfigError: one is not a recorded seed; or none is left to judge, and the table's judge has not the network.
    """
    seeds, is_judged = len(table.header.seeds), network in fresh_losses(table)
    left = "" if is_judged else ", and not all of them"
    expected = f"numbers of the {seeds} recorded seeds that evaluated the network, such as [0]{left}"
    remedy = "" if is_judged else "`tacevo judge` trains fresh seeds"
    if isinstance(seen, str) or not isinstance(seen, Iterable):
        raise ConfigError(repr(seen), place="seen", expected=expected, remedy=remedy)
    given = list(seen)
    try:
        known = {whole(seed, "seen", 0, seeds - 1) for seed in given}
    except ConfigError as error:
        raise ConfigError(error.got, place="seen", expected=expected, remedy=remedy) from None
    if not is_judged and len(known) == seeds:
        raise ConfigError(repr(given), place="seen", expected=expected, remedy=remedy)
    return known


def whole(value: object, place: str, least: int, most: int) -> int:
    """Return a whole number of any type that counts, but for a truth value."""
    try:
        number = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = None
    if number is None or not least <= number <= most:
        raise ConfigError(repr(value), place=place, expected=f"a whole number from {least} to {most}")
    return number
