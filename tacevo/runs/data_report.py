"""What `tacevo data check` found, as text for a person and as JSON for a machine."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacevo.choices import DataSource
from tacevo.config.schema import RunConfig
from tacevo.data.dataset import Dataset
from tacevo.data.labels import plain_name
from tacevo.data.source import Catalogue
from tacevo.data.survey import Survey, split_of
from tacevo.records import Json, to_json
from tacevo.text import counted

#: Equal or constant images that the report spells out before it only counts them; the JSON lists all.
SHOWN = 10

#: How a user says which images were recorded together.
_HOW = {
    DataSource.csv: "; name groups by data.group_column=COLUMN, or data.group_pattern='\"REGEX\"' on the paths",
    DataSource.folder: "; name groups by data.group_pattern='\"REGEX\"' on the paths",
    DataSource.numpy: "; name groups by an array `groups`",
}

_UNSIZED = " (data.image_size; an experiment may set another, so name that of the search here, too)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inspection:
    """What `check` found."""

    config: RunConfig
    dataset: Dataset
    survey: Survey
    #: Nearly equal images in two parts: a row and the row that it is like.
    alike: tuple[tuple[int, int], ...]
    #: What the data set was made from.
    catalogue: Catalogue
    #: The contact sheet.
    sheet: Path
    #: What the prompt tells the model of the images.
    told: str
    #: What is probably wrong, a sentence each.
    doubts: tuple[str, ...]
    #: Whether an experiment was named, or the size of the images, which an experiment may set.
    is_sized: bool


def describe(found: Inspection) -> dict[str, Json]:
    """Return an inspection as plain JSON values."""
    data, facts, survey = found.config.data, found.dataset.facts, found.survey
    counts = dict(zip(("train", "validation", "test"), facts.counts, strict=True))
    splits = split_of(found.dataset)
    return {
        "task": found.config.task.name,
        "source": data.source.value,
        "root": data.root,
        "kind": facts.kind.value,
        "names": list(facts.names),
        "images": {"all": sum(facts.counts), **counts},
        "skipped": found.catalogue.skipped,
        "ignored": [str(path) for path in found.catalogue.ignored],
        "recorded_size": to_json(found.catalogue.recorded_size),
        "image_size": facts.image_size,
        "parts": to_json(survey.parts),
        "mean": list(survey.mean),
        "deviation": list(survey.deviation),
        "duplicates": [
            {**to_json(group), "files": [_file(found, row) for row in group.rows], "leak": group.leak}
            for group in survey.duplicates
        ],
        "constant": list(survey.constant),
        "groups": _group_sizes(found),
        "nearly_equal": [
            {"rows": list(pair), "files": [_file(found, row) for row in pair], "parts": [splits[row] for row in pair]}
            for pair in found.alike
        ],
        "prompt": found.told,
        "warnings": _warnings(found),
        "fingerprint": facts.fingerprint,
        "cache": str(found.dataset.images.parent),
        "sheet": str(found.sheet),
    }


def report(found: Inspection) -> str:
    """Write an inspection for a person."""
    data, facts, survey = found.config.data, found.dataset.facts, found.survey
    train, validation, test = facts.counts
    size = f"{facts.image_size}x{facts.image_size}"
    recorded, skipped = found.catalogue.recorded_size, found.catalogue.skipped
    drawn = "drawn at" if recorded is None else "{}x{} pixels, used at".format(*recorded)
    moments = [f"{mean:.2f} +- {spread:.2f}" for mean, spread in zip(survey.mean, survey.deviation, strict=True)]
    lines = [
        f"source:      {data.source}{'' if data.root is None else f', {data.root}'}, task {found.config.task.name}",
        f"images:      {sum(facts.counts)}: {train} training, {validation} validation, {test} test",
        *([f"left out:    {counted(skipped, 'row')} whose image is missing (data.skip_missing)"] if skipped else []),
        *_ignored_lines(found),
        f"size:        {drawn} {size} pixels{'' if found.is_sized else _UNSIZED}",
        "labels:",
        *_label_lines(found),
        f"channels:    {', '.join(moments)} (mean and deviation of the training split, 0 to 255)",
        *_duplicate_lines(found),
        *_constant_lines(found),
        f"groups:      {_groups(found)}",
        *_alike_lines(found),
        f"prompt:      {found.told}",
        f"fingerprint: {facts.fingerprint}",
        f"cached in:   {found.dataset.images.parent}",
        f"look:        {found.sheet}",
        *(f"warning:     {words}" for words in _warnings(found)),
    ]
    return "\n".join(lines)


def _group_sizes(found: Inspection) -> list[int] | None:
    """Count the images of each group; None where no groups are known."""
    groups = found.catalogue.groups
    return None if groups is None else np.unique(groups, return_counts=True)[1].tolist()


def _groups(found: Inspection) -> str:
    """Say which images the split keeps together."""
    sizes, chosen_by = _group_sizes(found), found.catalogue.groups_chosen_by
    if found.catalogue.recorded_size is None:
        return "each image is a press of its own"
    if sizes is None:
        return f"none are known, so frames of one press may stand in two parts{_HOW.get(found.config.data.source, '')}"
    least, most = min(sizes), max(sizes)
    each = counted(most, "image") if least == most else f"{least} to {most} images"
    kept = "no two images share one" if most == 1 else "none in two parts"
    return f"{len(sizes)} of {each}, {kept}{'' if chosen_by is None else f' ({chosen_by})'}"


def _alike_lines(found: Inspection) -> Iterator[str]:
    """List nearly equal images in two parts."""
    splits = split_of(found.dataset)
    for pair in found.alike[:SHOWN]:
        yield "  nearly equal: " + " ~ ".join(f"{_row(found, row)} ({splits[row]})" for row in pair)
    if len(found.alike) > SHOWN:
        yield f"  and {len(found.alike) - SHOWN} more; --json lists all"


def _warnings(found: Inspection) -> list[str]:
    """Say what is probably wrong, a sentence each."""
    if not found.alike:
        return list(found.doubts)
    images = counted(len(found.alike), "image")
    return [
        *found.doubts,
        f"{images} for validation or test nearly equal one of another part, as frames of one press do: a network is "
        f"tested on what it has learnt{_HOW.get(found.config.data.source, '')}",
    ]


def _label_lines(found: Inspection) -> Iterator[str]:
    """Tabulate ranges or class counts by split."""
    parts, names = found.survey.parts, found.dataset.facts.names
    if parts[0].classes:
        width = max(map(len, names))
        yield "  " + " " * width + "".join(f"  {part.name:>10}" for part in parts)
        for number, name in enumerate(names):
            yield f"  {name.ljust(width)}" + "".join(f"  {part.classes[number]:>10}" for part in parts)
        return
    titles = [f"{plain_name(entry.name, entry.unit)} [{entry.unit or 'unit unknown'}]" for entry in parts[0].ranges]
    width = max(map(len, titles))
    yield "  " + " " * (width + 12) + "".join(f"  {head:>9}" for head in ("min", "max", "mean", "deviation"))
    for number, title in enumerate(titles):
        for part in parts:
            entry = part.ranges[number]
            values = (entry.minimum, entry.maximum, entry.mean, entry.deviation)
            yield f"  {title.ljust(width)}  {part.name:<10}" + "".join(f"  {value:>9.4g}" for value in values)


def _duplicate_lines(found: Inspection) -> Iterator[str]:
    """List equal images, those that straddle splits before the others."""
    groups, leaks = found.survey.duplicates, found.survey.leaks
    if not groups:
        yield "equal:       no two images are equal"
        return
    verdict = f"{len(leaks)} of them in more than one split, which is a leak" if leaks else "each within one split"
    yield f"equal:       {counted(len(groups), 'group')} of equal images, {verdict}"
    for group in sorted(groups, key=lambda group: not group.leak)[:SHOWN]:
        members = [f"{_row(found, row)} ({part})" for row, part in zip(group.rows, group.parts, strict=True)]
        yield f"  {'leak: ' if group.leak else ''}{_shortened(members, ' = ')}"
    if len(groups) > SHOWN:
        yield f"  and {counted(len(groups) - SHOWN, 'more group')}; --json lists all"


def _constant_lines(found: Inspection) -> Iterator[str]:
    rows = [_row(found, row) for row in found.survey.constant]
    images = f"{counted(len(rows), 'image')} of one colour: {_shortened(rows, ', ')}" if rows else "no image"
    yield f"constant:    {images}"


def _ignored_lines(found: Inspection) -> Iterator[str]:
    """Name the files that lie among the images and are not used."""
    files = list(map(str, found.catalogue.ignored))
    if files:
        yield f"ignored:     {counted(len(files), 'file')} outside the data set: {_shortened(files, ', ')}"


def _row(found: Inspection, row: int) -> str:
    """Name a row so that its image can be found."""
    file = _file(found, row)
    return f"row {row}" if file is None else f"row {row} {file}"


def _file(found: Inspection, row: int) -> str | None:
    """Name the file of a row; None where images are not files."""
    files = found.catalogue.files
    return None if files is None else str(files[row])


def _shortened(items: Sequence[str], joint: str) -> str:
    return joint.join(items[:SHOWN]) + (f"{joint}..." if len(items) > SHOWN else "")
