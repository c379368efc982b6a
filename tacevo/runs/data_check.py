"""`tacevo data`: looking at a data set before a search, and writing a simulated one as files."""

import shlex
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from tacevo.choices import Normalisation, RecordedTask
from tacevo.config.compose import compose
from tacevo.config.schema import RunConfig
from tacevo.config.task_texts import load_task
from tacevo.data.dataset import Dataset
from tacevo.data.labels import units_of
from tacevo.data.pictures import contact_sheet, format_of, sample_figure, save
from tacevo.data.scaling import input_statistics
from tacevo.data.splitting import PARTS
from tacevo.data.survey import constant_images, equal_images, label_table, nearly_equal, split_of
from tacevo.environment import as_typed
from tacevo.errors import ConfigError
from tacevo.parts.source import Catalogue
from tacevo.records import DataFacts, Task
from tacevo.runs.data_report import Image, Inspection
from tacevo.runs.data_warnings import told, warnings_of
from tacevo.runs.datasets import load_data, load_same, source_of
from tacevo.runs.progress import Progress
from tacevo.text import counted

#: Stands for the choice that some experiments leave to the user: a data set is looked at without a model.
_NO_MODEL = "llm=grammar"


def inspect_data(overrides: Sequence[str], output: str | None, console: Console) -> Inspection:
    """Load a data set as a search would, count it and write a contact sheet.

    Without `output`, the sheet is `contact-sheet-<fingerprint>.png` in the current directory.

    Raises:
        TacevoError: the data set is broken, does not suit the task, or the sheet's name has an unknown ending.
    """
    path = None if output is None else _writable(output)
    config, catalogue, dataset, task = _loaded(overrides, console)
    units, facts, splits = units_of(catalogue), dataset.facts, split_of(dataset)
    path = path or Path(f"contact-sheet-{facts.fingerprint[:8]}.png")
    counts = " / ".join(map(str, facts.counts))
    title = f"{config.task.name} ({config.data.source}): {counts} images, fingerprint {facts.fingerprint[:8]}"
    title += _stretched(catalogue.recorded_size, facts.image_size)
    save(contact_sheet(dataset, units=units, title=title), path)

    def image(row: int) -> Image:
        return Image(row=row, part=splits[row], file=None if catalogue.files is None else str(catalogue.files[row]))

    pixels = np.load(dataset.images, mmap_mode="r")
    mean, deviation = input_statistics(pixels, dataset.train, Normalisation.standardise)
    alike = () if config.data.facts.is_made else nearly_equal(dataset)
    groups = catalogue.groups
    is_release = config.data.facts.is_release
    release, differing = _compared(config) if is_release else ((), ())
    return Inspection(
        task=config.task.name,
        source=config.data.source,
        root=config.data.root,
        recorded_with=_recorded_with(config) if is_release else (),
        kind=facts.kind,
        names=facts.names,
        images={"all": sum(facts.counts), **dict(zip(PARTS, facts.counts, strict=True))},
        skipped=catalogue.skipped,
        selected=facts.selected,
        release=release,
        ignored=tuple(map(str, catalogue.ignored)),
        recorded_size=catalogue.recorded_size,
        image_size=facts.image_size,
        is_sized=any(override.startswith(("experiment=", "data.image_size=")) for override in overrides),
        labels=tuple(label_table(dataset, units).to_dict("records")),
        mean=mean,
        deviation=deviation,
        duplicates=tuple(tuple(map(image, rows)) for rows in equal_images(pixels)),
        constant=tuple(map(image, constant_images(pixels))),
        groups=None if groups is None else tuple(np.unique(groups, return_counts=True)[1].tolist()),
        test_groups=None if groups is None else facts.units,
        groups_chosen_by=catalogue.groups_chosen_by,
        nearly_equal=tuple((image(row), image(other)) for row, other in alike),
        prompt=told(task),
        warnings=(
            *warnings_of(config, task, dataset, catalogue),
            *_alike_words(len(alike), "" if groups is not None else config.data.facts.grouping),
            *(["data.root is not the whole release: what differs stands above"] if differing else []),
        ),
        fingerprint=facts.fingerprint,
        cache=str(dataset.images.parent),
        sheet=str(path),
    )


def _stretched(recorded: tuple[int, int] | None, size: int) -> str:
    """Say on a sheet that its images are not as they were recorded, of (width, height), where these are no squares."""
    if recorded is None or recorded[0] == recorded[1]:
        return ""
    width, height = recorded
    return f"; {width}x{height} pixels, stretched to {size}x{size}, as the network sees them"


def _recorded_with(config: RunConfig) -> tuple[str, ...]:
    """Return the settings that say which directories of the release are read."""
    pattern = config.data.pattern if config.task.name == RecordedTask.grating else None
    return (f"data.sensor={config.data.sensor}", *([] if pattern is None else [f"data.pattern={pattern}"]))


def _alike_words(count: int, remedy: str) -> list[str]:
    if not count:
        return []
    return [
        f"{counted(count, 'image')} for validation or test nearly equal one of another part, as frames of one press "
        f"do: a network is tested on what it has learnt{remedy}"
    ]


def show(overrides: Sequence[str], output: str, width: str, console: Console) -> Path:
    """Draw the sample pictures of a data set; return the file.

    Raises:
        TacevoError: as `inspect_data`.
    """
    path = _writable(output)
    _, catalogue, dataset, _ = _loaded(overrides, console)
    save(sample_figure(dataset, units=units_of(catalogue), width=width), path)
    return path


def samples_of_run(config: RunConfig, facts: DataFacts, console: Console) -> Figure:
    """Draw the sample pictures of the data set that a run of these settings searched with.

    What is simulated again is kept in the store that the settings name.

    Raises:
        DataError: the data set is missing, or is not the one of these facts.
        ConfigError: the settings name no data that can be read.
    """
    catalogue = source_of(config).catalogue()
    with Progress(console) as view:
        dataset = load_same(config, facts, view, catalogue=catalogue)
    return sample_figure(dataset, units=units_of(catalogue), width="double")


def simulate(settings: Sequence[str], console: Console) -> str:
    """Write a simulated data set as files.

    The settings are overrides as for a search, and `out=DIR`, and `n=IMAGES` for `data.images`.

    Returns:
        What was written, and the command that reads it.

    Raises:
        TacevoError: a setting is missing or wrong, or the directory exists.
    """
    out, overrides = _taken_out(settings)
    try:
        config = compose([_NO_MODEL, *overrides])
    except ConfigError as error:
        if any(setting.startswith("n=") for setting in settings):
            error.place = error.place.replace("data.images", "n")  # as the user wrote it
        raise
    source = source_of(config)
    if not config.data.facts.is_made:
        raise ConfigError(str(config.data.source), place="data", expected="simulated, which alone is written as files")
    from tacevo.data.simulator.tasks import Simulated
    from tacevo.data.simulator.written_files import overrides_for, write_files

    assert isinstance(source, Simulated)
    with Progress(console) as view:
        count = write_files(source, out, workers=config.executor.workers, progress=partial(view.advance, "images"))
    command = shlex.join(overrides_for(source, out))
    return f"{count} images and their labels: {out}\nread them: {as_typed('tacevo')} data check {command}"


def _compared(config: RunConfig) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Compare a release with what is known of it, by files."""
    from tacevo.data.sources.release import compared

    return compared(Path(config.data.root or ""))


def _loaded(overrides: Sequence[str], console: Console) -> tuple[RunConfig, Catalogue, Dataset, Task]:
    """Load a data set, and check that it suits its task, as a search does."""
    config = compose([_NO_MODEL, *overrides])
    catalogue = source_of(config).catalogue()
    with Progress(console) as view:
        dataset = load_data(config, view, catalogue=catalogue)
    return config, catalogue, dataset, load_task(config, dataset.facts)


def _writable(name: str) -> Path:
    """Check the name of a picture before any work is done for it."""
    path = Path(name)
    format_of(path)
    if path.is_dir():
        raise ConfigError(f"{path}, which is a directory", place="-o", expected="a file name")
    if not path.absolute().parent.is_dir():
        raise ConfigError(f"{path.parent}, which is not one", place="-o", expected="a file in a directory")
    return path


def _taken_out(settings: Sequence[str]) -> tuple[Path, list[str]]:
    """Take `out=` out of the overrides, and write `n=` by its long name."""
    outs = [setting.removeprefix("out=") for setting in settings if setting.startswith("out=")]
    if len(outs) != 1 or not outs[0]:
        raise ConfigError(str(outs), place="out", expected="one new directory, as in out=DIR")
    others = [setting for setting in settings if not setting.startswith("out=")]
    return Path(outs[0]), [f"data.images={own[2:]}" if own.startswith("n=") else own for own in others]
