"""The report of `tacevo data check`: a record that is its JSON, and the same as text for a person."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from tacevo.parts.facts import source_facts
from tacevo.records import Json, Kind
from tacevo.results.grouped import FEWEST
from tacevo.text import counted, unbroken

#: Equal or constant images that the report spells out before it only counts them; the JSON lists all.
SHOWN = 10

_UNSIZED = " (data.image_size; an experiment may set another, so name that of the search here, too)"


@dataclass(frozen=True, slots=True, kw_only=True)
class Image:
    """One image of a data set."""

    row: int
    #: `train`, `validation` or `test`.
    part: str
    #: The file of the image; None where images are not files.
    file: str | None

    def __str__(self) -> str:
        return f"row {self.row}{'' if self.file is None else f' {self.file}'} ({self.part})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """The findings of `check`."""

    task: str
    source: str
    root: str | None
    #: TacVerse: of which sensors, and of gratings which patterns; as settings.
    recorded_with: tuple[str, ...]
    kind: Kind
    names: tuple[str, ...]
    #: The number of images in `all` and in each part.
    images: Mapping[str, int]
    #: Rows of a table that were left out, because their image is missing.
    skipped: int
    #: The settings that selected images of the recording.
    selected: tuple[str, ...]
    #: The content of a directory of TacVerse, compared with that of the release; a line for each task.
    release: tuple[str, ...]
    #: Files beside the images that are not used.
    ignored: tuple[str, ...]
    #: Width and height before resizing; None where images are drawn.
    recorded_size: tuple[int, int] | None
    image_size: int
    #: Whether an experiment was named, or the size of the images, which an experiment may set.
    is_sized: bool
    #: The rows of `label_table`.
    labels: tuple[dict[str, Json], ...]
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    #: Groups of images with equal pixels.
    duplicates: tuple[tuple[Image, ...], ...]
    #: Images of one colour.
    constant: tuple[Image, ...]
    #: The number of images in each group that was recorded together; None where no groups are known.
    groups: tuple[int, ...] | None
    #: The number of groups with images in the test part.
    test_groups: int | None
    #: The setting that names them, if one does.
    groups_chosen_by: str | None
    #: Images that are nearly equal to one of an earlier part, each with that one.
    nearly_equal: tuple[tuple[Image, Image], ...]
    #: The description of the images in the prompt.
    prompt: str
    #: The probable faults, a sentence each.
    warnings: tuple[str, ...]
    fingerprint: str
    #: The directory of the finished images, and the contact sheet.
    cache: str
    sheet: str

    @property
    def leaks(self) -> list[tuple[Image, ...]]:
        """Groups of equal images in more than one part, so that a network is tested on what it has learnt."""
        return [images for images in self.duplicates if len({image.part for image in images}) > 1]


def report(data: Inspection) -> str:
    """Write an inspection for a person."""
    size = f"{data.image_size}x{data.image_size}"
    made = "drawn at" if source_facts(data.source).is_made else "made at"
    drawn = made if data.recorded_size is None else "{}x{} pixels, used at".format(*data.recorded_size)
    moments = [f"{mean:.2f} +- {spread:.2f}" for mean, spread in zip(data.mean, data.deviation, strict=True)]
    labels = [
        {name: unbroken(cell) if isinstance(cell, str) else cell for name, cell in row.items()} for row in data.labels
    ]
    table = pd.DataFrame(labels).to_string(index=False, float_format="{:.4g}".format)
    origin = [data.source, *([] if data.root is None else [data.root]), *data.recorded_with]
    lines = [
        f"source:      {', '.join(origin)}, task {data.task}",
        "images:      {all}: {train} training, {validation} validation, {test} test".format(**data.images),
        *([f"selected:    by {', '.join(data.selected)}"] if data.selected else []),
        *(f"release:     {words}" for words in data.release),
        *_listed("left out:    {} whose image is missing (data.skip_missing)", "row", data.skipped),
        *_listed("ignored:     {} outside the data set: ", "file", len(data.ignored), data.ignored, ", "),
        f"size:        {drawn} {size} pixels{'' if data.is_sized else _UNSIZED}",
        "labels:",
        *(f"  {line}" for line in table.splitlines()),
        f"channels:    {', '.join(moments)} (mean and deviation of the training split, 0 to 255)",
        *_equal_lines(data),
        *(_listed("constant:    {} of one colour: ", "image", len(data.constant), data.constant, ", ")),
        f"groups:      {_groups(data)}",
        *_first("  nearly equal: ", data.nearly_equal, " ~ "),
        f"prompt:      {data.prompt}",
        f"fingerprint: {data.fingerprint}",
        f"cached in:   {data.cache}",
        f"look:        {data.sheet}",
        *(f"warning:     {words}" for words in data.warnings),
    ]
    return "\n".join(unbroken(line) for line in lines)


def _listed(words: str, kind: str, count: int, items: Sequence[object] = (), joint: str = "") -> list[str]:
    """Count things and name the first of them; nothing where there are none."""
    return [words.format(counted(count, kind)) + _shortened(items, joint)] if count else []


def _groups(data: Inspection) -> str:
    """Say which images the split keeps together."""
    if source_facts(data.source).is_made:
        return "each image is a press of its own"
    if data.groups is None:
        is_told = not any(setting.startswith("data.test_sensor=") for setting in data.selected)  # it has its own split
        how = source_facts(data.source).grouping if is_told else ""
        return f"none are known, so frames of one press may stand in two parts{how}"
    least, most = min(data.groups), max(data.groups)
    each = counted(most, "image") if least == most else f"{least} to {most} images"
    kept = "no two images share one" if most == 1 else "none in two parts"
    chosen_by = "" if data.groups_chosen_by is None else f" ({data.groups_chosen_by})"
    tested = data.test_groups or 0
    few = f", each of which counts once: too few for tests over them, which take {FEWEST}" if tested < FEWEST else ""
    return f"{len(data.groups)} of {each}, {kept}{chosen_by}; {tested} for the test{few}"


def _equal_lines(data: Inspection) -> Iterator[str]:
    """List equal images, those that straddle splits before the others."""
    leaks = data.leaks
    if not data.duplicates:
        yield "equal:       no two images are equal"
        return
    verdict = f"{len(leaks)} of them in more than one split, which is a leak" if leaks else "each within one split"
    yield f"equal:       {counted(len(data.duplicates), 'group')} of equal images, {verdict}"
    yield from _first("  leak: ", leaks, " = ")
    yield from _first("  ", [images for images in data.duplicates if images not in leaks], " = ")


def _first(words: str, groups: Sequence[Sequence[Image]], joint: str) -> Iterator[str]:
    """List the first groups of images, and count the others."""
    for images in groups[:SHOWN]:
        yield f"{words}{_shortened(images, joint)}"
    if len(groups) > SHOWN:
        yield f"  and {len(groups) - SHOWN} more; --json lists all"


def _shortened(items: Sequence[object], joint: str) -> str:
    return joint.join(map(str, items[:SHOWN])) + (f"{joint}..." if len(items) > SHOWN else "")
