"""The re-estimates of a run's fitnesses: what its studies and noise runs recorded under other seeds.

A study trains with the search's optimiser, batches and data, so its validation losses in as many epochs as the search
trained for give the fitness under another seed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacevo.config.schema import RunConfig
from tacevo.errors import CacheMissError, RunError
from tacevo.parts.kinds import FITNESS
from tacevo.parts.registry import of_settings
from tacevo.results.study import LOWER_IS_BETTER, PRIMARY
from tacevo.results.study_directory import FinishedStudy
from tacevo.results.study_lines import FailedLine, ScoreLine, StudyHeader, StudyNetwork
from tacevo.rounding import rounded
from tacevo.storage.store import place_of, read_entry
from tacevo.storage.verdicts import read_verdict
from tacevo.text import counted
from tacevo.training.full import FullTraining


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """The losses, fitnesses and test scores that a study recorded, for n networks, S >= 2 seeds and E epochs."""

    #: The validation loss of each epoch, shape (n, S, E).
    losses: NDArray[np.float64]
    #: The fitness, by the search's rule, after so many epochs, shape (n, S, E).
    fitness: NDArray[np.float64]
    #: The test score of the weights of the best validation epoch, lower is better, shape (n, S).
    tested: NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reestimates:
    """The fitnesses of a run's networks under other seeds, as a study or a noise run recorded them."""

    #: The name of its directory.
    name: str
    #: The baseline first; those that every seed trained.
    networks: tuple[StudyNetwork, ...]
    #: The re-estimates of each of them, seed by seed.
    estimates: tuple[tuple[float, ...], ...]
    #: The epochs of the search's trainings.
    epochs: int
    #: None for a noise run, which tests nothing, and for one seed, which cannot stand on two sides.
    curves: Curves | None = None
    #: The others, with which some seed failed; never the baseline.
    failed: tuple[StudyNetwork, ...] = ()
    #: The rule by which a fitness follows from the losses of a training.
    rule: str = "last"
    #: True where they were looked up in a table, which has no more seeds than were recorded.
    looked_up: bool = False

    @property
    def kind(self) -> str:
        """The kind of record, in words."""
        return "noise run" if self.curves is None else "study"

    @property
    def fitness(self) -> str:
        """The meaning of a fitness, in words."""
        epochs = counted(self.epochs, "epoch")
        match self.rule:
            case "last":
                return f"the validation loss after {epochs}"
            case "lowest":
                return f"the lowest validation loss of {epochs}"
            case "mean_of_3":
                return f"the mean validation loss of the last 3 of {epochs}"
            case brought:
                return f"{brought} of the validation losses of {epochs}"

    @property
    def seeds(self) -> int:
        """Re-estimates of each network."""
        return len(self.estimates[0])

    @property
    def medians(self) -> tuple[float, ...]:
        """The median of the re-estimates of each network."""
        return tuple(rounded(float(np.median(values))) for values in self.estimates)

    def estimates_of(self, name: str) -> tuple[float, ...]:
        """Return the re-estimates of a candidate, by its id; none where it was not trained again."""
        return next((values for one, values in zip(self.networks, self.estimates, strict=True) if one.id == name), ())

    def median_of(self, name: str) -> float | None:
        """Return the median of a candidate's re-estimates, by its id; None where it was not trained again."""
        return next((median for one, median in zip(self.networks, self.medians, strict=True) if one.id == name), None)


def by_seeds(reestimates: Sequence[Reestimates]) -> list[Reestimates]:
    """Return re-estimates with those of the most seeds first; where several know a network, the first one counts."""
    return sorted(reestimates, key=lambda one: (-one.seeds, one.name))


def losses_by_source(reestimates: Sequence[Reestimates]) -> dict[str, tuple[float, ...]]:
    """Return the re-estimates of each network by the SHA-256 of its source."""
    losses: dict[str, tuple[float, ...]] = {}
    for one in reversed(by_seeds(reestimates)):
        losses |= {network.source: values for network, values in zip(one.networks, one.estimates, strict=True)}
    return losses


def medians_by_id(reestimates: Sequence[Reestimates]) -> dict[str, float]:
    """Return the median re-estimate of each candidate that was trained again, and of the baseline, by id."""
    medians: dict[str, float] = {}
    for one in reversed(by_seeds(reestimates)):
        medians |= {network.id: median for network, median in zip(one.networks, one.medians, strict=True)}
    return medians


def load_reestimates(finished: FinishedStudy, config: RunConfig, fingerprint: str, store: Path) -> Reestimates | None:
    """Read what a finished study or noise run says of its run's fitnesses.

    Args:
        finished: the study.
        config: of its run.
        fingerprint: of the run's data.
        store: the directory of the stores, where a study has the losses of each epoch.

    Returns:
        None where its losses are not fitnesses: other data, another recipe, fewer epochs than the search had; a choice.

    Raises:
        RunError: a training of the baseline failed.
        CacheMissError: the store lacks a training.
        StoreError: an entry of the store is damaged.
    """
    header, rows, place = finished.header, finished.rows, str(finished.path)
    if not _trains_alike(header, config, fingerprint):
        return None
    names = [(network.name, seed) for network in header.networks for seed in range(header.seeds)]
    by_name = {(row.network, row.seed): row for row in rows}
    if len(rows) != len(names) or by_name.keys() != set(names):
        raise RunError(f"{len(rows)} others", place=place, expected="one score for each network and seed")
    failed = {row.network for row in rows if isinstance(row, FailedLine)}
    baseline = header.networks[0].name
    if baseline in failed:
        raise RunError(
            f"a training of the {baseline} that failed", place=place, expected="a baseline that trains with every seed"
        )
    networks = tuple(network for network in header.networks if network.name not in failed)
    sound = [row for row in (by_name[name] for name in names) if isinstance(row, ScoreLine)]
    ordered, shape = [row for row in sound if row.network not in failed], (len(networks), header.seeds)
    epochs, name = config.training.epochs, config.training.fitness
    recorded = None
    if header.terms is None:
        fitness = np.array([row.validation_loss for row in ordered]).reshape(shape)
    else:
        if name not in FITNESS.ours:
            expected = f"one of {', '.join(FITNESS.ours)}: what another is after fewer epochs was not recorded"
            raise RunError(name, place=f"training.fitness of {finished.path.name}", expected=expected)
        rule = of_settings(FITNESS, name, config.training)
        curves = [losses_of(store, row) for row in ordered]
        so_far = [[rule.of(losses[:epoch]) for epoch in range(1, len(losses) + 1)] for losses in curves]
        by_epoch = np.array(so_far).reshape(*shape, -1)
        fitness = by_epoch[:, :, epochs - 1]
        if header.seeds > 1:
            tested = _tested(header, ordered).reshape(shape)
            recorded = Curves(losses=np.array(curves).reshape(*shape, -1), fitness=by_epoch, tested=tested)
    return Reestimates(
        name=finished.path.name,
        networks=networks,
        estimates=tuple(map(tuple, fitness.tolist())),
        epochs=epochs,
        rule=name,
        curves=recorded,
        failed=tuple(network for network in header.networks if network.name in failed),
        looked_up=config.data.facts.is_looked_up,
    )


def _trains_alike(header: StudyHeader, config: RunConfig, fingerprint: str) -> bool:
    """Return whether a study trains as the search did, and for as long at least."""
    training, recipe = config.training, header.recipe
    if header.is_choice:  # its lines have the lowest loss of more epochs, after which elites are chosen
        return False
    return recipe.epochs >= training.epochs and (
        (header.data.fingerprint, header.numerics, header.device, recipe.batch_size, recipe.learning_rate)
        == (fingerprint, config.numerics.kind, training.device, training.batch_size, training.learning_rate)
    )


def _tested(header: StudyHeader, rows: Sequence[ScoreLine]) -> NDArray[np.float64]:
    """Return the test score of each row, lower is better."""
    metric = PRIMARY[header.data.kind]
    return np.array([row.metrics[metric] for row in rows]) * (1 if LOWER_IS_BETTER[metric] else -1)


def losses_of(store: Path, row: ScoreLine) -> tuple[float, ...]:
    """Return the validation loss of each epoch of a study's training, from the stores.

    Raises:
        CacheMissError: they lack it.
        StoreError: its entry is damaged.
        RunError: it is a failure, which the score denies.
    """
    path = store / place_of("studies", row.evaluation)
    if not path.exists():
        raise CacheMissError(
            f"none of {row.network} with seed {row.seed}",
            place=str(store),
            expected="the trainings of the study",
            remedy="name the stores by store=DIR or --store DIR, or repeat the command of the study",
        )
    training = read_verdict(FullTraining, "full", read_entry(path).answer, place=str(path))
    if not isinstance(training, FullTraining):
        got = f"a rejection ({training.reason})"
        raise RunError(got, place=str(path), expected="a training, as the study's scores say")
    return training.training.validation_losses
