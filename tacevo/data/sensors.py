"""Recordings that name the sensor, or the part of the split, of each image: which images train and which are tested.

The rules are those of the release's authors (`tacevo.data.sources.tacverse`). All images are split first, whichever
sensors are chosen, so that a sensor has the same test images within it, across sensors and where it is left out. Then
the chosen sensors are taken; of a sensor that is tested and does not train, the test part, and of all others what is
not their test part; and some of its training part, where shots are asked for.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from tacevo.choices import ALL_SENSORS
from tacevo.data.source import check_no_faults, listed, shortened
from tacevo.data.splitting import PARTS, TENTHS, dealt
from tacevo.errors import DataError
from tacevo.parts.making import Given
from tacevo.parts.source import Split
from tacevo.randomness import stream
from tacevo.records import Json
from tacevo.storage.canonical import canonical

#: Joins the names of several sensors.
AND = "+"

#: The names, in lower case, that a recording may give to the parts of its split.
PART_NAMES = {
    **dict.fromkeys(("train", "training"), "train"),
    **dict.fromkeys(("val", "valid", "validation"), "validation"),
    **dict.fromkeys(("test", "testing"), "test"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensors:
    """The request of a user to a recording that names sensors, parts or both."""

    #: The names of the column, array or level of directories that holds each image's sensor, and its part; None:
    #: nothing does.
    sensor_column: str | None = None
    split_column: str | None = None
    #: The sensors that are taken, joined by `+`; `*` for all.
    sensor: str = ALL_SENSORS
    #: The sensor that is tested, which then does not train.
    test_sensor: str | None = None
    #: The amount of the tested sensor's training part that trains, too: groups of each class, or images where no groups
    #: are known.
    shots: int = 0
    #: The seed of the shots, and of a random split, whose parts the next field has.
    seed: int = 0
    held_out: tuple[float, float] = TENTHS

    @classmethod
    def from_settings(cls, given: Given) -> Self:
        """Return what the settings of `data` ask for."""
        data = given.settings
        return cls(
            sensor_column=data["sensor_column"],
            split_column=data["split_column"],
            sensor=data["sensor"],
            test_sensor=data["test_sensor"],
            shots=data["shots"],
            seed=data["split_seed"],
            held_out=(data["validation_part"], data["test_part"]),
        )

    @property
    def are_named(self) -> bool:
        """Whether the recording names anything of each image."""
        return self.sensor_column is not None or self.split_column is not None

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns, arrays or levels that name the sensors and the parts, in this order, as far as there are any."""
        return tuple(column for column in (self.sensor_column, self.split_column) if column is not None)

    @property
    def selected(self) -> tuple[str, ...]:
        """The settings that select images, as a user writes them; none where all is taken."""
        settings: dict[str, Json] = {"test_sensor": self.test_sensor, "shots": self.shots}
        if self.sensor_column is not None and self.sensor != ALL_SENSORS:
            settings = {"sensor": self.sensor, **settings}
        given = {name: value for name, value in settings.items() if value}
        return tuple(
            f"data.{name}={value if isinstance(value, str) else canonical(value)}" for name, value in given.items()
        )

    def described(self) -> dict[str, Json]:
        """Return what of this decides images and split, for the key of a data set; nothing where nothing is named."""
        if not self.are_named:
            return {}
        described: dict[str, Json] = {"sensor_column": self.sensor_column, "split_column": self.split_column}
        described |= {"sensor": self.sensor, "test_sensor": self.test_sensor}
        if self.shots or self.split_column is None:
            described |= {"shots": self.shots, "seed": self.seed}
        if self.split_column is None:
            described["held_out"] = list(self.held_out)
        return {"sensors": described}


#: The settings for a recording that names neither sensors nor parts.
NONE_NAMED = Sensors()


class Named(NamedTuple):
    """The names that a recording gives to its images. A group is of one sensor: each may number its presses anew."""

    #: The name of each image in messages.
    places: Sequence[str]
    #: The texts that name the sensor of each, and its part; None where nothing names them.
    sensors: Sequence[str] | None
    parts: Sequence[str] | None
    #: int64 (N,): of a classification.
    classes: npt.NDArray[np.int64] | None = None
    #: int64 (N,): equal for images of one press of a sensor; None: unknown.
    groups: npt.NDArray[np.int64] | None = None
    #: The setting that names the groups; None where the recording itself has them.
    groups_chosen_by: str | None = None


def taken(asked: Sensors, named: Named) -> tuple[list[int], dict[str, Any]]:
    """Choose the images that are used, and split them.

    Returns:
        The rows of these images, ascending; and fields of their catalogue: split, groups, what was selected.

    Raises:
        DataError: a sensor or a part is not known, a group has images in several parts, or there are fewer shots than
            asked for. A part may be empty.
    """
    sensors = np.array(named.sensors or [""] * len(named.places), dtype=object)
    if named.groups is not None:
        named = named._replace(groups=of_sensors(named.groups, named.sensors))
    chosen = _chosen(asked, named)
    parts = _recorded_parts(asked, named) if named.parts is not None else _dealt_parts(asked, named, sensors)
    if asked.test_sensor is None:
        used = np.isin(sensors, chosen)
    else:
        is_tested = sensors == asked.test_sensor
        used = np.isin(sensors, [*chosen, asked.test_sensor]) & (is_tested == (parts == "test"))
        used[_shots(asked, named, np.flatnonzero(is_tested & (parts == "train")))] = True
    rows = np.flatnonzero(used)
    split = Split(**{part: np.flatnonzero(parts[rows] == part) for part in PARTS})
    fields: dict[str, Any] = {"dealt": split, "selected": asked.selected}
    if named.groups is not None:
        fields |= {"groups": named.groups[rows], "groups_chosen_by": named.groups_chosen_by}
    return rows.tolist(), fields


def of_sensors(groups: npt.NDArray[np.int64], sensors: Sequence[str] | None) -> npt.NDArray[np.int64]:
    """Number groups anew, so that those of different sensors have different numbers."""
    if sensors is None:
        return groups
    pairs = list(zip(sensors, groups.tolist(), strict=True))
    numbers = {pair: number for number, pair in enumerate(dict.fromkeys(pairs))}
    return np.array([numbers[pair] for pair in pairs], np.int64)


def _chosen(asked: Sensors, named: Named) -> list[str]:
    """Return the sensors that train, each of which the recording names."""
    if named.sensors is None:
        return [""]
    known = sorted(set(named.sensors))
    expected = f"sensors that {asked.sensor_column} names, joined by {AND}: {listed(known)}; or {ALL_SENSORS} for all"
    wanted = known if asked.sensor == ALL_SENSORS else _names(asked.sensor, known)
    unknown = [name for name in wanted if name not in known]
    if unknown or len(set(wanted)) < len(wanted):
        got = listed([name or repr(name) for name in unknown]) if unknown else asked.sensor
        raise DataError(got, place="data.sensor", expected=f"different {expected}" if not unknown else expected)
    if asked.test_sensor is None:
        return wanted
    if asked.test_sensor not in known:
        expected = f"a sensor that {asked.sensor_column} names: {listed(known)}"
        raise DataError(asked.test_sensor, place="data.test_sensor", expected=expected)
    train = [name for name in wanted if name != asked.test_sensor]
    if not train:
        expected = f"another sensor than data.sensor={asked.sensor}, or null"
        raise DataError(asked.test_sensor, place="data.test_sensor", expected=expected)
    return train


def _names(text: str, known: Sequence[str]) -> list[str]:
    """Take names apart that are joined by `+`; a known one that holds it stays whole, the longest first."""
    if text in known:
        return [text]
    whole = [name for name in known if text.startswith(name + AND)]
    name = max(whole, key=len) if whole else text.partition(AND)[0]
    return [name, *_names(text[len(name) + 1 :], known)] if text != name else [text]


def _recorded_parts(asked: Sensors, named: Named) -> npt.NDArray[np.object_]:
    """Read the part of each image as the recording names it; a group is in one of them."""
    texts = [text.strip().casefold() for text in named.parts or ()]
    check_no_faults(
        f"{asked.split_column} names parts that are not known",
        [
            f"{place} {shortened(own)}"
            for place, own, text in zip(named.places, named.parts or (), texts, strict=True)
            if text not in PART_NAMES
        ],
        "correct them",
        place="data.split_column",
        expected=f"one of {listed(list(PART_NAMES))} for each image",
    )
    parts = np.array([PART_NAMES[text] for text in texts], dtype=object)
    if named.groups is not None:
        check_no_faults(
            f"{asked.split_column} puts images of one group into several parts",
            list(_torn(named, parts)),
            f"put all images of a group into one part, or correct {named.groups_chosen_by or 'the groups'}",
            place="data.split_column",
        )
    return parts


def _torn(named: Named, parts: npt.NDArray[np.object_]) -> Iterator[str]:
    """Name the groups whose images are in several parts, by the first image of each such part."""
    assert named.groups is not None  # as the caller has seen
    first: dict[int, dict[str, str]] = {}
    for group, part, place in zip(named.groups.tolist(), parts.tolist(), named.places, strict=True):
        first.setdefault(group, {}).setdefault(part, place)
    for known in first.values():
        if len(known) > 1:
            yield " and ".join(f"{place} in {part}" for part, place in known.items())


def _dealt_parts(asked: Sensors, named: Named, sensors: npt.NDArray[np.object_]) -> npt.NDArray[np.object_]:
    """Deal all images out at random, each class of each sensor evenly."""
    classes = np.zeros(len(sensors), np.int64) if named.classes is None else named.classes
    kinds = sorted(set(zip(sensors.tolist(), classes.tolist(), strict=True)))
    numbers = {kind: number for number, kind in enumerate(kinds)}
    strata = np.array([numbers[kind] for kind in zip(sensors.tolist(), classes.tolist(), strict=True)], np.int64)
    split = dealt(
        len(sensors),
        asked.seed,
        held_out=asked.held_out,
        groups=named.groups,
        chosen_by=named.groups_chosen_by,
        classes=strata,
    )
    parts = np.empty(len(sensors), dtype=object)
    for part in PARTS:
        parts[getattr(split, part)] = part
    return parts


def _shots(asked: Sensors, named: Named, rows: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Draw groups of each class, or images, out of the training part of the tested sensor; return their rows."""
    if not asked.shots:
        return rows[:0]
    pools: defaultdict[int, list[int]] = defaultdict(list)
    unit = np.arange(len(named.places)) if named.groups is None else named.groups
    kind = np.zeros(len(named.places), np.int64) if named.classes is None else named.classes
    for row in rows.tolist():
        pools[int(kind[row])].append(int(unit[row]))
    least = min((len(set(pool)) for pool in pools.values()), default=0)
    if asked.shots > least:
        what = "images" if named.groups is None else "groups of images"
        each = "" if named.classes is None else " of each class"
        expected = f"at most {least}, the {what} that the training part of {asked.test_sensor} has{each}"
        raise DataError(str(asked.shots), place="data.shots", expected=expected)
    drawn: set[tuple[int, int]] = set()
    for number, pool in pools.items():
        order = stream(asked.seed, "shots", number).permutation(sorted(Counter(pool)))
        drawn |= {(number, one) for one in order[: asked.shots].tolist()}
    return np.array([row for row in rows.tolist() if (int(kind[row]), int(unit[row])) in drawn], np.int64)
