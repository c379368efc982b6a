"""The data set that a configuration names."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from tacevo.config.chosen import part_of
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import check_fit
from tacevo.data.dataset import Dataset
from tacevo.data.loading import load
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, DataError
from tacevo.parts.kinds import SOURCES
from tacevo.parts.registry import find
from tacevo.parts.registry import load as load_part
from tacevo.parts.source import Catalogue, Source
from tacevo.records import DataFacts, Task
from tacevo.runs.brought_source import BroughtSource
from tacevo.runs.progress import Progress
from tacevo.sandbox.client import RunJob
from tacevo.training.evaluation import Evaluator, Examples
from tacevo.training.full import HeldOut
from tacevo.training.losses import trivial_loss


def load_same(config: RunConfig, facts: DataFacts, view: Progress, *, catalogue: Catalogue | None = None) -> Dataset:
    """Load the data set that a run had.

    Raises:
        DataError: it is missing, or is not the one that the run had.
    """
    data = load_data(config, view, catalogue=catalogue)
    if data.facts.fingerprint != facts.fingerprint:
        raise DataError(
            f"one with the fingerprint {data.facts.fingerprint[:12]}: images, labels or split differ",
            place=f"data={config.data.source}",
            expected=f"the run's data set, of fingerprint {facts.fingerprint[:12]}",
            remedy="restore the data set of the run",
        )
    if facts.groups not in {(), data.facts.groups}:
        raise DataError(
            "one whose test images are in other groups",
            place=f"data={config.data.source}",
            expected="the run's data set, with the groups that the run recorded",
            remedy="restore the data set of the run",
        )
    return data


def load_data(config: RunConfig, view: Progress, *, catalogue: Catalogue | None = None) -> Dataset:
    """Load or make the data set that a configuration names.

    A catalogue of this very source, where it is there already, is not listed again.

    Raises:
        DataError: it is missing or broken.
        ConfigError: it does not suit the task, or is a table that does not suit the run; or a part is missing.
        BundleError: it is a table that is damaged.
    """
    return answering(config).data(view, catalogue)


def source_of(config: RunConfig) -> Source:
    """Make the part that a configuration's images come from; nothing is read yet.

    Raises:
        ConfigError: the source is missing, does not know the task, or has no images.
    """
    if config.data.facts.is_looked_up:
        raise ConfigError(
            "the table of a space, which holds no images",
            place=f"data={config.data.source}",
            expected="images",
            remedy="`tacevo.open_table(FILE).scores` are the test scores of all its networks",
        )
    source: Source = part_of(config, SOURCES)
    part = find(SOURCES, config.data.source)
    return source if part.is_ours else BroughtSource(part, source)


def trivial_of(config: RunConfig, task: Task, data: Dataset) -> float:
    """Return the trivial loss of a run's validation images."""
    return answering(config).trivial(task, data)


class Answering(Protocol):
    """The source of a run's answers to probes and trainings."""

    @property
    def run(self) -> RunJob | None:
        """The function that answers jobs in the place of an executor; None where candidates run."""
        ...

    @property
    def evaluator(self) -> Callable[..., Evaluator]:
        """The function that makes the evaluator of a search; its arguments are those of `Evaluator`."""
        ...

    def data(self, view: Progress, catalogue: Catalogue | None) -> Dataset:
        """Return the data set; errors are those of `load_data`."""
        ...

    def trivial(self, task: Task, data: Dataset) -> float:
        """Return the trivial loss of the validation images."""
        ...


def answering(config: RunConfig) -> Answering:
    """Return how the probes and the trainings of a run are answered: candidates run, or all is looked up.

    Raises:
        ConfigError: what looks up is not installed.
    """
    if not config.data.facts.is_looked_up:
        return _Trained(config)
    looked_up: Answering = load_part(SOURCES, config.data.source)(config)
    return looked_up


@dataclass(frozen=True, slots=True)
class _Trained:
    """Candidates run on the images of a source (see `Answering`)."""

    config: RunConfig

    @property
    def run(self) -> None:
        return None

    @property
    def evaluator(self) -> Callable[..., Evaluator]:
        return Evaluator

    def data(self, view: Progress, catalogue: Catalogue | None) -> Dataset:
        config = self.config
        return load(
            source_of(config),
            split=config.data.split,
            split_seed=config.data.split_seed,
            held_out=config.data.held_out,
            normalisation=config.data.normalisation,
            target_scaling=config.task.target_scaling,
            cache=Path(config.store.root) / "data",
            workers=min(config.executor.workers, usable_cores()),
            accept=lambda catalogue: check_fit(
                config.task, kind=catalogue.kind, outputs=len(catalogue.names), names=catalogue.names
            ),
            progress=partial(view.advance, "images"),
            say=view.say,
            catalogue=catalogue,
        )

    def trivial(self, task: Task, data: Dataset) -> float:
        return trivial_loss(task.contract.loss, data.targets[data.validation])


def examples_of(data: Dataset) -> Examples:
    """Return what a search trains and validates on."""
    return Examples(
        train=data.train,
        validation=data.validation,
        train_targets=data.targets[data.train],
        validation_targets=data.targets[data.validation],
        mean=data.mean,
        deviation=data.deviation,
        fingerprint=data.facts.fingerprint,
    )


def held_out_of(data: Dataset) -> HeldOut:
    """Return the test images, which no search has."""
    return HeldOut(rows=data.test, targets=data.targets[data.test], names=data.facts.names, scale=data.scale)
