"""What `tacevo data check` found as text for a person; `inspect_data` says what the findings hold."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from tacevo.choices import DataSource
from tacevo.text import counted

#: Equal or constant images that the report spells out before it only counts them; the JSON lists all.
SHOWN = 10

#: How a user says which images were recorded together.
HOW = {
    DataSource.csv: "; name groups by data.group_column=COLUMN, or data.group_pattern='\"REGEX\"' on the paths",
    DataSource.folder: "; name groups by data.group_pattern='\"REGEX\"' on the paths",
    DataSource.tacverse: "; name groups by data.split=random data.group_pattern='\"REGEX\"' on the paths",
    DataSource.numpy: "; name groups by an array `groups`",
}

_UNSIZED = " (data.image_size; an experiment may set another, so name that of the search here, too)"


#: What `inspect_data` returns.
Findings = Mapping[str, Any]


def leaks(data: Findings) -> list[list[dict[str, Any]]]:
    """Return the groups of equal images in more than one part, so that a network is tested on what it has learnt."""
    return [images for images in data["duplicates"] if len({image["part"] for image in images}) > 1]


def report(data: Findings) -> str:
    """Write findings for a person."""
    size, skipped = data["image_size"], data["skipped"]
    drawn = "drawn at" if data["recorded_size"] is None else "{}x{} pixels, used at".format(*data["recorded_size"])
    moments = [f"{mean:.2f} +- {spread:.2f}" for mean, spread in zip(data["mean"], data["deviation"], strict=True)]
    table = pd.DataFrame(data["labels"]).to_string(index=False, float_format="{:.4g}".format)
    origin = [data["source"], *([] if data["root"] is None else [data["root"]]), *data["recorded_with"]]
    lines = [
        f"source:      {', '.join(origin)}, task {data['task']}",
        "images:      {all}: {train} training, {validation} validation, {test} test".format(**data["images"]),
        *(["selected:    by " + ", ".join(data["selected"])] if data["selected"] else []),
        *(f"release:     {words}" for words in data["release"]),
        *([f"left out:    {counted(skipped, 'row')} whose image is missing (data.skip_missing)"] if skipped else []),
        *_listed("ignored:     {} outside the data set: ", "file", data["ignored"]),
        f"size:        {drawn} {size}x{size} pixels{'' if data['is_sized'] else _UNSIZED}",
        "labels:",
        *(f"  {line}" for line in table.splitlines()),
        f"channels:    {', '.join(moments)} (mean and deviation of the training split, 0 to 255)",
        *_equal_lines(data),
        *_listed("constant:    {} of one colour: ", "image", list(map(_name, data["constant"]))),
        f"groups:      {_groups(data)}",
        *_first("  nearly equal: ", data["nearly_equal"], " ~ "),
        f"prompt:      {data['prompt']}",
        f"fingerprint: {data['fingerprint']}",
        f"cached in:   {data['cache']}",
        f"look:        {data['sheet']}",
        *(f"warning:     {words}" for words in data["warnings"]),
    ]
    return "\n".join(lines)


def _listed(words: str, kind: str, items: Sequence[str]) -> list[str]:
    """Count things and name the first of them; nothing where there are none."""
    return [f"{words.format(counted(len(items), kind))}{_shortened(items, ', ')}"] if items else []


def _groups(data: Findings) -> str:
    """Say which images the split keeps together."""
    if data["recorded_size"] is None:
        return "each image is a press of its own"
    groups, chosen_by = data["groups"], data["groups_chosen_by"]
    if groups is None:
        # A sensor that is tested has its own split.
        is_told = not any(setting.startswith("data.test_sensor=") for setting in data["selected"])
        how = HOW.get(data["source"], "") if is_told else ""
        return f"none are known, so frames of one press may stand in two parts{how}"
    least, most = min(groups), max(groups)
    each = counted(most, "image") if least == most else f"{least} to {most} images"
    kept = "no two images share one" if most == 1 else "none in two parts"
    return f"{len(groups)} of {each}, {kept}{'' if chosen_by is None else f' ({chosen_by})'}"


def _equal_lines(data: Findings) -> Iterator[str]:
    """List equal images, those that straddle splits before the others."""
    groups, torn = data["duplicates"], leaks(data)
    if not groups:
        yield "equal:       no two images are equal"
        return
    verdict = f"{len(torn)} of them in more than one split, which is a leak" if torn else "each within one split"
    yield f"equal:       {counted(len(groups), 'group')} of equal images, {verdict}"
    yield from _first("  leak: ", torn, " = ")
    yield from _first("  ", [images for images in groups if images not in torn], " = ")


def _first(words: str, groups: Sequence[Sequence[Mapping[str, Any]]], joint: str) -> Iterator[str]:
    """List the first groups of images, and count the others."""
    for images in groups[:SHOWN]:
        yield f"{words}{_shortened(list(map(_name, images)), joint)}"
    if len(groups) > SHOWN:
        yield f"  and {len(groups) - SHOWN} more; --json lists all"


def _shortened(items: Sequence[str], joint: str) -> str:
    return joint.join(items[:SHOWN]) + (f"{joint}..." if len(items) > SHOWN else "")


def _name(image: Mapping[str, Any]) -> str:
    file = "" if image["file"] is None else f" {image['file']}"
    return f"row {image['row']}{file} ({image['part']})"
