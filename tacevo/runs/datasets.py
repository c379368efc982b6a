"""The data set that a configuration names."""

from functools import partial
from pathlib import Path
from typing import TypeVar

from tacevo.choices import DataSource, RecordedTask, SensorTask, SimulatedSensor
from tacevo.config.schema import DataConfig, RunConfig
from tacevo.config.task_texts import check_fit
from tacevo.data.dataset import Dataset
from tacevo.data.loading import load
from tacevo.data.sensors import Sensors
from tacevo.data.simulator.tasks import Simulated
from tacevo.data.source import Catalogue, Source
from tacevo.data.sources.arrays import Arrays
from tacevo.data.sources.folder import Folder
from tacevo.data.sources.table import TableSource
from tacevo.data.sources.tacverse import TacVerse
from tacevo.environment import usable_cores
from tacevo.errors import ConfigError, DataError
from tacevo.records import DataFacts, Task
from tacevo.runs.looked_up import data_of, table_of
from tacevo.runs.progress import Progress
from tacevo.training.evaluation import Examples
from tacevo.training.full import HeldOut
from tacevo.training.losses import trivial_loss

T = TypeVar("T", RecordedTask, SensorTask)


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
        ConfigError: it does not suit the task, or is a table that does not suit the run.
        BundleError: it is a table that is damaged.
    """
    if config.data.source is DataSource.table:
        return data_of(table_of(config))
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


def source_of(config: RunConfig) -> Source:
    """Name where a configuration's images come from; nothing is read yet.

    Raises:
        ConfigError: the source does not know the task, or has no images.
    """
    data = config.data
    root = Path(data.root or "")
    match data.source:
        case DataSource.simulated:
            return Simulated(
                task=_among(SensorTask, config),
                images=data.images or 0,  # which `check_together` excludes
                image_size=data.image_size,
                seed=data.seed,
                spacings_mm=tuple(data.spacings_mm),
                sensor_seed=data.sensor_seed,
                light=data.light,
                sensor=SimulatedSensor(data.sensor),  # which `check_together` has looked at
                gel_mm=data.gel_mm,
            )
        case DataSource.csv:
            return TableSource(
                root=root,
                table=data.table,
                image_column=data.image_column,
                target_columns=tuple(data.target_columns),
                image_size=data.image_size,
                skip_missing=data.skip_missing,
                white_point=data.white_point,
                group_column=data.group_column,
                group_pattern=data.group_pattern,
                sensors=_sensors_of(data),
            )
        case DataSource.folder:
            return Folder(
                root=root,
                image_size=data.image_size,
                white_point=data.white_point,
                group_pattern=data.group_pattern,
                sensors=_sensors_of(data),
            )
        case DataSource.tacverse:
            return TacVerse(
                root=root,
                task=_among(RecordedTask, config),
                sensor=data.sensor,
                pattern=data.pattern,
                image_size=data.image_size,
                skip_missing=data.skip_missing,
                white_point=data.white_point,
                group_pattern=data.group_pattern,
                spacings_mm=tuple(data.spacings_mm) if data.select else (),
                images=data.images if data.select else None,
                classes=data.classes,
                test_sensor=data.test_sensor,
                shots=data.shots,
                seed=data.split_seed,
            )
        case DataSource.numpy:
            return Arrays(
                root=root, image_size=data.image_size, white_point=data.white_point, sensors=_sensors_of(data)
            )
        case DataSource.table:
            raise ConfigError(
                "the table of a space, which holds no images",
                place="data=table",
                expected="images",
                remedy="`tacevo.open_table(FILE).scores` are the test scores of all its networks",
            )


def _sensors_of(data: DataConfig) -> Sensors:
    """Return which sensors and parts are asked for of a recording that names them."""
    return Sensors(
        sensor_column=data.sensor_column,
        split_column=data.split_column,
        sensor=data.sensor,
        test_sensor=data.test_sensor,
        shots=data.shots,
        seed=data.split_seed,
        held_out=data.held_out,
    )


def _among(tasks: type[T], config: RunConfig) -> T:
    """Find a configuration's task among those of its source."""
    try:
        return tasks(config.task.name)
    except ValueError as error:
        raise ConfigError(
            config.task.name,
            place=f"task.name with data={config.data.source}",
            expected=f"one of {', '.join(tasks)}",
            remedy="choose other data",
        ) from error


def trivial_of(config: RunConfig, task: Task, data: Dataset) -> float:
    """Return the trivial loss of a run's validation images, which a table recorded."""
    if config.data.source is DataSource.table:
        return table_of(config).header.trivial
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
