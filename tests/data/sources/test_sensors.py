"""Promise: a table, directories or an archive may name the sensor and the part of each image, as the release does."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from refusals import refused
from small_recordings import loaded, save_image

from tacevo.choices import SplitRule
from tacevo.data.loading import split_rows
from tacevo.data.sensors import Named, Sensors, taken
from tacevo.data.sources.arrays import Arrays
from tacevo.data.sources.folder import Folder
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue

SENSORS, KINDS, EACH = ("A", "B", "C"), ("coarse", "fine"), 10

#: Of each image: sensor, kind, and the part that the recording names, six in ten for training.
IMAGES = [
    (sensor, kind, number, ("train" if number < 6 else "Val" if number < 8 else "testing"))
    for sensor, kind, number in product(SENSORS, KINDS, range(EACH))
]

Recording = TableSource | Folder | Arrays


def table(root: Path) -> TableSource:
    """Write a table whose columns name sensor and part; the label is the number of the image."""
    lines = []
    for row, (sensor, kind, number, part) in enumerate(IMAGES):
        save_image(root / f"{sensor}_{kind}_{number}.png", row)
        lines.append(f"{sensor}_{kind}_{number}.png,{row},{sensor} ,{part},{kind}{number // 2}\n")
    (root / "labels.csv").write_text("image,depth,Gel,use,press\n" + "".join(lines))
    named = Sensors(sensor_column="gel", split_column="use")
    columns = {"image_column": "image", "target_columns": ("depth",), "image_size": 16}
    return TableSource(root=root, table="labels.csv", sensors=named, **columns)  # type: ignore[arg-type]


def folders(root: Path) -> Folder:
    """Write directories: classes, in these parts, in these sensors."""
    for row, (sensor, kind, number, part) in enumerate(IMAGES):
        save_image(root / kind / part / sensor / f"{sensor}_{kind}_{number}.png", row)
    return Folder(root=root, image_size=16, sensors=Sensors(sensor_column="3", split_column="2"))


def arrays(root: Path) -> Arrays:
    """Write an archive with two arrays more."""
    images = np.array([np.full((8, 8), row, np.uint8) for row in range(len(IMAGES))])
    sensors, kinds, _, parts = zip(*IMAGES, strict=True)
    labels = np.array([KINDS.index(kind) for kind in kinds])
    path = root / "all.npz"
    np.savez(path, images=images, labels=labels, sensor=np.array(sensors), part=np.array(parts))
    return Arrays(root=path, image_size=16, sensors=Sensors(sensor_column="sensor", split_column="part"))


MADE = pytest.mark.parametrize("make", [table, folders, arrays])


def asking(source: Recording, **asked: object) -> Recording:
    """Ask for other sensors or parts."""
    return replace(source, sensors=replace(source.sensors, **asked))  # type: ignore[arg-type]


def without_parts(source: Recording) -> Recording:
    """Let nothing name the part of an image."""
    if isinstance(source, Folder):
        for kind, (_, _, _, part) in product(KINDS, IMAGES):
            for folder in sorted((source.root / kind / part).glob("*")):
                (source.root / kind / folder.name).mkdir(exist_ok=True)
                for path in folder.iterdir():
                    path.rename(source.root / kind / folder.name / path.name)
                folder.rmdir()
        for left in sorted(source.root.glob("*/*")):
            if not any(left.iterdir()):
                left.rmdir()
        return asking(source, sensor_column="2", split_column=None)
    if isinstance(source, Arrays):
        with np.load(source.root) as known:
            kept = {name: known[name] for name in known.files if name != "part"}
        np.savez(source.root, **kept)
    return asking(source, split_column=None)


def parts_of(source: Recording) -> dict[str, list[tuple[str, str, int, str]]]:
    """Return what each part holds, known by the colour of its pictures."""
    catalogue = source.catalogue()
    split = split_rows(catalogue, SplitRule.random, seed=5)
    colours = [int(picture()[0, 0, 0]) for picture in catalogue.pictures]
    rows: dict[str, npt.NDArray[np.int64]] = {
        "train": split.train,
        "validation": split.validation,
        "test": split.test,
    }
    assert sorted(np.concatenate(list(rows.values())).tolist()) == list(range(len(colours)))
    return {part: [IMAGES[colours[row]] for row in own] for part, own in rows.items()}


@MADE
def test_recorded_parts_are_the_split(tmp_path: Path, make: Callable[[Path], Recording]) -> None:
    """By their names in any case; labels stay with their images, and a seed changes nothing."""
    source = make(tmp_path)
    parts = parts_of(source)
    assert {part: {image[3] for image in own} for part, own in parts.items()} == {
        "train": {"train"},
        "validation": {"Val"},
        "test": {"testing"},
    }
    assert sum(map(len, parts.values())) == len(IMAGES)
    assert asking(source, seed=1).describe() == source.describe()
    data = loaded(source, tmp_path / "cache", split_seed=3)
    assert data.facts.counts == (36, 12, 12)
    assert data.facts.selected == ()


@MADE
@pytest.mark.parametrize("split", ["recorded", "random"])
def test_protocols_of_the_release(tmp_path: Path, make: Callable[[Path], Recording], split: str) -> None:
    """Within a sensor, across, left out and few shots: the tested images are the same, and train in none of them."""
    source = make(tmp_path)
    if split == "random":
        source = asking(without_parts(source), held_out=(0.2, 0.2), seed=4)
    within = parts_of(asking(source, sensor="C"))
    assert {image[0] for own in within.values() for image in own} == {"C"}
    assert [len(own) for own in within.values()] == [12, 4, 4]
    for train in ("A", "A+B", "A+B+C", "*"):
        across = parts_of(asking(source, sensor=train, test_sensor="C"))
        assert across["test"] == within["test"]
        others = {"A"} if train == "A" else {"A", "B"}
        assert {image[0] for image in across["train"]} == {image[0] for image in across["validation"]} == others
        assert len(across["train"]) == 12 * len(others)
    few = [parts_of(asking(source, test_sensor="C", shots=2, seed=seed)) for seed in (4, 4)]
    added = [sorted(image for image in own["train"] if image[0] == "C") for own in few]
    is_classified = not isinstance(source, TableSource)
    assert len(added[0]) == (4 if is_classified else 2)
    assert added[0] == added[1]
    assert set(added[0]) <= set(within["train"])
    assert [own["test"] for own in few] == [within["test"]] * 2
    assert asking(source, sensor="A").describe() != asking(source, sensor="B").describe()
    selected = asking(source, sensor="A+B", test_sensor="C", shots=2).catalogue().selected
    assert selected == ("data.sensor=A+B", "data.test_sensor=C", "data.shots=2")


@MADE
def test_unknown_sensors_are_refused(tmp_path: Path, make: Callable[[Path], Recording]) -> None:
    """With those that are there; a sensor cannot be the only one that trains and be tested."""
    source = make(tmp_path)
    for asked in ("D", "A+D", "A+", ""):
        with refused(DataError, place="data.sensor", expected="A, B, C"):
            asking(source, sensor=asked).catalogue()
    with refused(DataError, place="data.sensor", expected="different"):
        asking(source, sensor="A+A").catalogue()
    with refused(DataError, place="data.test_sensor", got="D", expected="A, B, C"):
        asking(source, test_sensor="D").catalogue()
    with refused(DataError, place="data.test_sensor", got="A", expected="another sensor"):
        asking(source, sensor="A", test_sensor="A").catalogue()
    with refused(DataError, place="data.shots", got="100", expected="at most"):
        asking(source, test_sensor="C", shots=100).catalogue()


def test_parts_that_are_not_known_or_empty_are_refused(tmp_path: Path) -> None:
    """Each faulty row is named; a part without an image cannot be trained on or tested."""
    source = table(tmp_path)
    text = (tmp_path / "labels.csv").read_text()
    (tmp_path / "labels.csv").write_text(text.replace("A ,train", "A ,dev"))
    with refused(DataError, place="data.split_column", got="line 2 'A_coarse_0.png' 'dev'", expected="train"):
        source.catalogue()
    (tmp_path / "labels.csv").write_text(text.replace(",testing,", ",,"))
    with refused(DataError, got="rows without a value in use"):
        source.catalogue()
    (tmp_path / "labels.csv").write_text(text.replace(",testing,", ",train,"))
    with refused(DataError, got="parts of the split have no images (1 found): test"):
        split_rows(source.catalogue(), SplitRule.random, seed=0)
    with refused(DataError, place="the columns of labels.csv", expected="'place'", remedy="data.split_column"):
        asking(source, split_column="place").catalogue()


def test_group_in_two_parts_is_refused(tmp_path: Path) -> None:
    """A press of a sensor is in one part; presses of another sensor may have the same numbers."""
    source = replace(table(tmp_path), group_column="press")
    catalogue = source.catalogue()
    assert catalogue.groups is not None
    assert len(set(catalogue.groups.tolist())) == len(IMAGES) // 2
    few = asking(source, test_sensor="C", shots=2)
    assert isinstance(few, TableSource)
    assert len([image for image in parts_of(few)["train"] if image[0] == "C"]) == 4  # two presses of two frames
    text = (tmp_path / "labels.csv").read_text()
    (tmp_path / "labels.csv").write_text(text.replace("testing,coarse3", "testing,coarse2"))
    assert source.catalogue().labels.size == len(IMAGES)
    (tmp_path / "labels.csv").write_text(text.replace("Val,coarse3", "Val,coarse2"))
    with refused(DataError, place="data.split_column", got="in train and ", remedy="data.group_column"):
        source.catalogue()


def test_groups_are_kept_together_where_sensors_are_split_at_random(tmp_path: Path) -> None:
    """No press is torn, and each sensor has its share of each part."""
    source = asking(replace(table(tmp_path), group_column="press"), split_column=None, held_out=(0.2, 0.2))
    parts = parts_of(source)
    presses = {part: {(image[0], image[1], image[2] // 2) for image in own} for part, own in parts.items()}
    assert sum(map(len, presses.values())) == len(set().union(*presses.values())) == len(IMAGES) // 2
    for own in parts.values():
        assert {image[0] for image in own} == set(SENSORS)


def test_images_of_other_sensors_may_have_another_size(tmp_path: Path) -> None:
    """Sensors are looked at by themselves; together they must agree, or be cropped."""
    source = folders(tmp_path)
    for path in sorted(tmp_path.rglob("B_*.png")):
        save_image(path, 3, size=(12, 8))
    assert loaded(asking(source, sensor="A+C"), tmp_path / "cache").facts.counts == (24, 8, 8)
    assert loaded(asking(source, sensor="B"), tmp_path / "cache").facts.counts == (12, 4, 4)
    with refused(DataError, got="several sizes"):
        asking(source).catalogue()


def test_description_without_names_is_that_of_earlier_versions(tmp_path: Path) -> None:
    """Seed, sensors and parts enter the key where something names them, and only there."""
    plain = replace(table(tmp_path), sensors=Sensors())
    assert "sensors" not in str(plain.describe())
    assert replace(plain, sensors=Sensors(sensor="A", seed=3)).describe() == plain.describe()
    assert plain.catalogue().dealt is None


def test_levels_that_are_not_there_are_refused(tmp_path: Path) -> None:
    """The class needs a level of its own."""
    source = folders(tmp_path)
    with refused(DataError, place="data.root", expected="4 levels of directories, of which level 1 names the class"):
        asking(source, sensor_column="4").catalogue()
    save_image(tmp_path / "coarse" / "train" / "lost.png", 1)
    with refused(DataError, place="data.root", got="coarse/train/lost.png", expected="below 3 levels"):
        source.catalogue()


def test_parts_are_no_classes_where_another_level_names_sensors(tmp_path: Path) -> None:
    """As they are not where nothing is named; the remedy is the setting that takes them."""
    for part in ("train", "val", "test"):
        save_image(tmp_path / part / "A" / "coarse" / "1.png", 1)
    with refused(DataError, place="data.root", got="the parts of a split", remedy="data.split_column=1"):
        Folder(root=tmp_path, image_size=16, sensors=Sensors(sensor_column="2")).catalogue()


def test_archive_lacks_an_array_that_is_named(tmp_path: Path) -> None:
    """The arrays that are there are listed; one that no setting names is refused as ever."""
    source = arrays(tmp_path)
    with refused(DataError, got="lacks arrays (1 found): gel", remedy="'sensor'"):
        asking(source, sensor_column="gel").catalogue()
    with refused(DataError, got="unknown arrays (1 found): part", remedy="data.split_column"):
        asking(source, split_column=None).catalogue()
    catalogue: Catalogue = source.catalogue()
    assert catalogue.dealt is not None


@pytest.mark.parametrize(
    ("asked", "expected"),
    [("A", "A"), ("A+B", "A+B"), ("B+C", "B,C"), ("A+B+C", "A+B,C"), ("C+A+B", "A+B,C"), ("C+A", "A,C")],
)
def test_name_that_holds_the_sign_of_a_list_is_a_name(asked: str, expected: str) -> None:
    """`A+B` is a sensor where the recording names it, alone and beside others."""
    sensors = ["A", "A+B", "B", "C"] * 3
    parts = np.repeat(["train", "val", "test"], 4).tolist()
    named = Named(places=[*map(str, range(12))], sensors=sensors, parts=parts)
    rows, _ = taken(Sensors(sensor_column="gel", split_column="part", sensor=asked), named)
    assert ",".join(sorted({sensors[row] for row in rows})) == expected
