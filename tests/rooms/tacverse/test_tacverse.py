"""The TacVerse layout: rows in the release's order, its own split, presses kept together, slips told by name."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from small_recordings import loaded, save_forces, save_gratings, save_image

from tacevo.choices import GratingClasses, RecordedTask, SplitRule
from tacevo.data.loading import split_rows
from tacevo.data.sources.tacverse import TacVerse
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue, Split
from tacevo.records import Kind


def reds(catalogue: Catalogue) -> list[int]:
    """Decode every picture to its red, which tells which file it was."""
    return [int(picture()[0, 0, 0]) for picture in catalogue.pictures]


def released(catalogue: Catalogue) -> Split:
    """Take the release's own parts."""
    return split_rows(catalogue, SplitRule.release, seed=0)


def test_forces_name_no_groups_and_no_units(tmp_path: Path) -> None:
    """Forces of the release may be in N or in mN; columns are taken by name, in any case and order."""
    source = save_forces(tmp_path, "6,image_2.png,4,5\n9,image_0.png,7,8\n", header="FZ, Image_Name , Fx ,fY\n")
    catalogue = source.catalogue()
    assert catalogue.labels.tolist() == [[7, 8, 9], [4, 5, 6]]
    assert (catalogue.kind, catalogue.names, catalogue.units) == (Kind.regression, ("Fx", "Fy", "Fz"), None)
    assert (catalogue.groups, catalogue.recorded_size) == (None, (8, 8))


def test_hardness_is_read_but_has_no_split_of_its_own(tmp_path: Path) -> None:
    """The form is ours, so no release says how to split it."""
    save_forces(tmp_path, "")
    folder = tmp_path / "Hardness_Regression"
    source = TacVerse(root=tmp_path, task=RecordedTask.hardness, sensor="ViTacTip", pattern=None, image_size=16)
    with refused(DataError, place="data.root", expected="the release has no hardness"):
        source.catalogue()
    (tmp_path / "Force_Regression").rename(folder)
    (folder / "ViTacTip" / "ViTacTip.csv").write_text("image_name,shore\nimage_1.png,20\nimage_0.png,17.5\n")
    catalogue = source.catalogue()
    assert catalogue.names == ("shore",)
    assert catalogue.labels.tolist() == [[17.5], [20.0]]
    with refused(DataError, place="data.split", remedy="set data.split=random"):
        released(catalogue)


def test_gratings_come_by_size_press_and_frame(tmp_path: Path) -> None:
    """All three are numbers: 0.5 before 1.0 before 10, press 2 before 10; `<size>_<group>` is frame 0."""
    names = ("10_1.png", "0.50_10.png", "0.5_2_1.jpeg", "0.5_2.JPG", "1.0_1_3.tif")
    catalogue = save_gratings(tmp_path, *names).catalogue()
    assert catalogue.names == ("0.5 mm", "1 mm", "10 mm")
    assert catalogue.labels.tolist() == [0, 0, 0, 1, 2]
    assert reds(catalogue) == pytest.approx([3, 2, 1, 4, 0], abs=1)  # JPEG files keep colours nearly
    assert catalogue.groups is not None
    assert catalogue.groups.tolist() == [0, 0, 1, 2, 3]
    others = save_gratings(tmp_path / "other", *(name.replace("1.0_1_3", "2_1_3") for name in names))
    assert others.describe() != save_gratings(tmp_path, *names).describe()


def test_too_few_presses_are_refused(tmp_path: Path) -> None:
    """Two presses of a size leave none for the test; nothing is decoded to find that."""
    source = save_gratings(tmp_path, *(f"{size}_{row % 2}_{row}.png" for size in (0.5, 1) for row in range(10)))
    with refused(DataError, place="the test split", got="no images of 2 of 2 classes (0.5 mm, 1 mm)"):
        loaded(source, tmp_path / "cache", split=SplitRule.release)


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ("image_0.png,1,2,3\nimage_9.png,1,2,3\n", "Force_Regression/ViTacTip (1 found): line 3 'image_9.png'"),
        ("image_0.png,1,2,3\n./image_0.png,1,2,3\n", "line 3 './image_0.png'"),
        ("plain.png,1,2,3\n", "line 2 'plain.png'; end names with their number"),
        ("", "ViTacTip.csv: expected a row for each image"),
    ],
)
def test_broken_rows_are_named_by_line(tmp_path: Path, rows: str, place: str) -> None:
    """Every kind of broken row has its place; and so have an absent column, and an absent table."""
    source = save_forces(tmp_path, rows)
    directory = tmp_path / "Force_Regression" / "ViTacTip"
    save_image(directory / "plain.png", 0)
    with pytest.raises(DataError) as told:
        source.describe()
    assert place in str(told.value)
    (directory / "ViTacTip.csv").write_text("image_name,fx,fy\nimage_0.png,1,2\n")
    with refused(DataError, expected="'fz'", got="'image_name', 'fx', 'fy'", remedy="the layout fixes"):
        source.describe()
    (directory / "ViTacTip.csv").unlink()
    with refused(DataError, expected="a table beside the images", got="ViTacTip.csv"):
        source.describe()


def test_missing_images_are_left_out_where_that_is_asked_for(tmp_path: Path) -> None:
    """As the release's own code does; the split counts the images that are there."""
    rows = "".join(f"image_{number}.png,{number},0,0\n" for number in range(20))
    source = replace(save_forces(tmp_path, rows, images=10), skip_missing=True)
    catalogue = source.catalogue()
    assert reds(catalogue) == list(range(10))
    assert released(catalogue).test.tolist() == [8, 9]


@pytest.mark.parametrize(
    ("names", "place"),
    [
        (
            ("1_1.png", "flat.png", "1_2_3_4.png", "-1_2.png", "1_x.png", "1,5_2.png"),
            "(5 found): -1_2.png, 1,5_2.png, ",
        ),
        *((("0.5_1.png", twin), "(1 found): 0.5") for twin in ("0.50_1.png", "0.5_1_0.png", "0.5_1.jpg", "0.5_01.png")),
        ((), "data.pattern: expected a directory with .jpeg, .jpg, "),
    ],
)
def test_images_that_are_no_presses_are_refused(tmp_path: Path, names: tuple[str, ...], place: str) -> None:
    """A name without size and press has no class, and equal numbers are one picture; other files are left alone."""
    source = save_gratings(tmp_path, *names)
    pattern = tmp_path / "Grating_Classification" / "ViTacTip" / "Blackdot"
    (pattern / "notes.txt").write_text("a rainy day")
    with pytest.raises(DataError) as told:
        source.describe()
    assert place in str(told.value)


@pytest.mark.parametrize(
    ("change", "place", "remedy"),
    [
        ({"root": "absent"}, "data.root", "holds: empty, release, file"),
        ({"root": "file"}, "data.root", "holds: empty, release, file; did you mean"),
        ({"root": "."}, "data.root", "holds: empty, release, file"),
        ({"root": "release/Grating_Classification"}, "data.root", "Grating_Classification holds: ViTacTip"),
        ({"root": "empty"}, "data.root", "holds: nothing"),
        ({"sensor": "GelSight"}, "data.sensor", "Grating_Classification holds: ViTacTip"),
        ({"sensor": "VitacTip"}, "data.sensor", "Grating_Classification/ViTacTip?"),
        ({"pattern": "Dots"}, "data.pattern", "ViTacTip holds: Blackdot"),
        ({"pattern": None}, "data.pattern", "ViTacTip holds: Blackdot"),
    ],
)
def test_wrong_place_says_what_is_there(tmp_path: Path, change: dict[str, str | None], place: str, remedy: str) -> None:
    """The error names the setting, what is there instead, and the nearest name."""
    source = save_gratings(tmp_path / "release", "1_1.png", "2_1.png")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    wrong = {key: tmp_path / str(value) if key == "root" else value for key, value in change.items()}
    with refused(DataError, place=place, remedy=remedy):
        replace(source, **wrong).describe()  # type: ignore[arg-type]


def save_release(root: Path, sensors: tuple[str, ...] = ("ViTacTip", "TacTip")) -> TacVerse:
    """Write two patterns of each sensor: four sizes, of which each has ten presses of two frames."""
    names = [f"{size}_{press}_{frame}.png" for size in (0.3, 0.5, 1.0, 1.75) for press in range(10) for frame in (1, 2)]
    for sensor in sensors:
        for pattern in ("Blackdot", "Blackline"):
            for number, name in enumerate(names):
                save_image(root / "Grating_Classification" / sensor / pattern / name, number)
    return replace(save_gratings(root), pattern="Blackdot+Blackline")


def save_shapes(root: Path, *sensors: str) -> TacVerse:
    """Write ten images of each of two shapes."""
    for sensor in sensors:
        for shape in ("ring", "ball"):
            for number in range(10):
                save_image(root / "Shape_Classification" / sensor / shape / f"{shape}{number}.png", number)
    return replace(save_gratings(root), task=RecordedTask.shape, sensor="+".join(sensors))


def files_of(catalogue: Catalogue, part: str) -> list[str]:
    """Return the paths of a part, below the root, without ending."""
    paths = [catalogue.files[row] for row in getattr(released(catalogue), part)]  # type: ignore[index]
    return [re.sub(r".*_Classification/|.png", "", path.as_posix()) for path in paths]


def test_spacings_select_the_sizes_and_images_cap_them(tmp_path: Path) -> None:
    """The classes follow; each has as many images, at even steps of its presses; what was selected is told."""
    every = replace(save_release(tmp_path), pattern="Blackdot")
    some = replace(every, spacings_mm=(1.0, 0.5))
    assert some.catalogue().names == ("0.5 mm", "1 mm")
    assert np.bincount(some.catalogue().labels).tolist() == [20, 20]
    capped = replace(some, images=21).catalogue()
    assert np.bincount(capped.labels).tolist() == [11, 10]
    assert {name.split("_")[1] for name in files_of(capped, "train")} == set("012345")
    assert capped.selected == ("data.spacings_mm=[1.0,0.5]", "data.images=21")
    assert loaded(replace(some, images=21), tmp_path / "c", split=SplitRule.release).facts.selected == capped.selected
    descriptions = [source.describe() for source in (every, some, replace(some, images=21), replace(every, images=21))]
    assert all(a != b for number, a in enumerate(descriptions) for b in descriptions[:number])
    assert every.catalogue().selected == ()
    assert "selected" not in str(every.describe())
    with refused(DataError, place="data.spacings_mm", expected="0.3, 0.5, 1, 1.75", got="2"):
        replace(every, spacings_mm=(0.5, 2.0)).describe()


def test_forces_are_capped_at_even_steps(tmp_path: Path) -> None:
    """So the split in time is that of the whole recording; more than there are is all."""
    source = save_forces(tmp_path, "".join(f"image_{number}.png,{number},0,0\n" for number in range(20)), images=20)
    capped = replace(source, images=10).catalogue()
    assert reds(capped) == list(range(0, 20, 2))
    assert released(capped).test.tolist() == [8, 9]
    assert reds(replace(source, images=99).catalogue()) == list(range(20))


def test_pattern_in_a_name_groups_forces(tmp_path: Path) -> None:
    """The release names no presses of forces; a recording's own names may."""
    rows = "".join(f"press{number // 4}/image_{number}.png,{number},0,0\n" for number in range(24))
    source = replace(save_forces(tmp_path, rows, images=0), group_pattern=r"ViTacTip/press(\d+)/")
    for number in range(24):
        save_image(tmp_path / "Force_Regression" / "ViTacTip" / f"press{number // 4}" / f"image_{number}.png", number)
    split = split_rows(source.catalogue(), SplitRule.random, seed=0)
    presses = [{row // 4 for row in part} for part in (split.train, split.validation, split.test)]
    assert sum(map(len, presses)) == len(set().union(*presses)) == 6


@pytest.mark.parametrize(
    ("classes", "names"),
    [
        (GratingClasses.size, ("0.5 mm", "1 mm")),
        (GratingClasses.pattern, ("dot", "line")),
        (GratingClasses.joint, ("dot 0.5 mm", "dot 1 mm", "line 0.5 mm", "line 1 mm")),
    ],
)
def test_patterns_are_classes_beside_sizes_or_in_their_place(
    tmp_path: Path, classes: GratingClasses, names: tuple[str, ...]
) -> None:
    """Two patterns are read together; each size of each is split by its presses."""
    source = replace(save_release(tmp_path), spacings_mm=(0.5, 1.0), classes=classes)
    catalogue = source.catalogue()
    assert catalogue.names == names
    assert len(set(np.bincount(catalogue.labels).tolist())) == 1
    for part, count in (("train", 6), ("validation", 2), ("test", 2)):
        presses = {name.rpartition("_")[0] for name in files_of(catalogue, part)}
        assert len(presses) == count * 4
    assert catalogue.groups is not None
    assert len(set(catalogue.groups.tolist())) == 40


def test_shapes_are_split_by_their_numbers(tmp_path: Path) -> None:
    """60/20/20 of each sensor's images of each shape, in the order of the last number in their names."""
    catalogue = save_shapes(tmp_path, "ViTacTip", "TacTip").catalogue()
    assert (catalogue.kind, catalogue.names) == (Kind.classification, ("ball", "ring"))
    assert files_of(catalogue, "test") == [
        f"{sensor}/{shape}/{shape}{number}"
        for sensor in ("TacTip", "ViTacTip")
        for shape in ("ball", "ring")
        for number in (8, 9)
    ]
    save_image(tmp_path / "Shape_Classification" / "TacTip" / "ball" / "plain.png", 0)
    with refused(DataError, got="TacTip has images without a number (1 found): ball/plain.png"):
        save_shapes(tmp_path, "ViTacTip", "TacTip").catalogue()


def test_protocols_of_the_release(tmp_path: Path) -> None:
    """Others train and are validated on, one sensor is tested; shots of its training part train, too, by a seed."""
    save_shapes(tmp_path, "A", "B", "C")
    source = replace(save_shapes(tmp_path, "A", "B"), test_sensor="C")
    left_out = source.catalogue()
    parts = {
        part: {name.split("/")[0] for name in files_of(left_out, part)} for part in ("train", "validation", "test")
    }
    assert parts == {"train": {"A", "B"}, "validation": {"A", "B"}, "test": {"C"}}
    assert [len(getattr(released(left_out), part)) for part in parts] == [24, 8, 4]
    few = [replace(source, shots=2, seed=seed).catalogue() for seed in (0, 0, 1)]
    added = [[name for name in files_of(catalogue, "train") if name.startswith("C")] for catalogue in few]
    assert added[0] == added[1] != added[2]
    assert [len(names) for names in added] == [4, 4, 4]
    assert all(int(name[-1]) < 6 for names in added for name in names)
    assert [files_of(catalogue, "test") for catalogue in few] == [files_of(left_out, "test")] * 3
    assert replace(source, shots=2).describe() != replace(source, shots=2, seed=1).describe()
    whole = replace(source, sensor="A+B+C")
    assert [path.as_posix() for path in whole.catalogue().files or ()] == [
        path.as_posix() for path in left_out.files or ()
    ]
    with refused(DataError, place="data.test_sensor", expected="another sensor", got="B"):
        replace(source, sensor="B", test_sensor="B").catalogue()


@pytest.mark.parametrize("end", ["_0", ""])
def test_number_of_a_shape_is_its_order_and_no_press(tmp_path: Path, end: str) -> None:
    """Where all or some images of a shape have one number, each still counts alone for split and shots."""
    for sensor in ("A", "B"):
        for number in range(10):
            save_image(
                tmp_path / "Shape_Classification" / sensor / "ball" / f"ball{number // 2}{number % 2}{end}.png", 0
            )
            save_image(
                tmp_path / "Shape_Classification" / sensor / "ring" / f"ring{'ab'[number % 2]}{number // 2}.png", 0
            )
    source = replace(save_gratings(tmp_path), task=RecordedTask.shape, sensor="A")
    parts = released(source.catalogue())
    assert [len(getattr(parts, part)) for part in ("train", "validation", "test")] == [12, 4, 4]
    assert files_of(source.catalogue(), "test")[:2] == [f"A/ball/ball4{last}{end}" for last in "01"]
    few = files_of(replace(source, test_sensor="B", shots=3).catalogue(), "train")
    assert sum(name.startswith("B/ball") for name in few) == sum(name.startswith("B/ring") for name in few) == 3


@pytest.mark.parametrize(("sensor", "ratio"), [("A", (3, 1, 1)), ("A+B+C", (6, 2, 1))])
@pytest.mark.parametrize("shots", [0, 2])
def test_images_cap_what_a_protocol_uses(tmp_path: Path, sensor: str, ratio: tuple[int, int, int], shots: int) -> None:
    """Each part and class keeps its share, whether one sensor trains or several, and shots come on top."""
    save_shapes(tmp_path, "A", "B", "C")
    every = replace(save_shapes(tmp_path, "A"), sensor=sensor, test_sensor="C", shots=shots)
    capped = replace(every, images=2 * sum(ratio)).catalogue()
    assert capped.release is not None
    sizes = [len(part) for part in (capped.release.train, capped.release.validation, capped.release.test)]
    assert sizes == [2 * ratio[0] + 2 * shots, 2 * ratio[1], 2 * ratio[2]]
    assert len(set(np.bincount(capped.labels).tolist())) == 1
    assert set(files_of(capped, "test")) <= set(files_of(every.catalogue(), "test"))
    assert sum(name.startswith("C") for name in files_of(capped, "train")) == 2 * shots


def test_more_shots_than_there_are_are_refused(tmp_path: Path) -> None:
    """Facts that say ninety-nine would not be true."""
    save_shapes(tmp_path, "A", "B", "C")
    source = replace(save_shapes(tmp_path, "A"), sensor="A", test_sensor="C", shots=99)
    with refused(DataError, place="data.shots", got="99", expected="at most"):
        source.catalogue()


def test_parts_stand_in_the_description(tmp_path: Path) -> None:
    """The same images are in other parts where one that a protocol leaves out is there or not: not one cache entry."""
    for number in range(8):
        for sensor, shape in (("A", "ball"), ("A", "ring"), ("B", "ball"), ("B", "ring")):
            save_image(tmp_path / "Shape_Classification" / sensor / shape / f"{number}.png", number)
    source = replace(save_gratings(tmp_path), task=RecordedTask.shape, sensor="A", test_sensor="B")
    full, described = source.catalogue(), source.describe()
    for shape in ("ball", "ring"):
        (tmp_path / "Shape_Classification" / "A" / shape / "7.png").unlink()
    assert source.catalogue().files == full.files
    assert len(released(source.catalogue()).train) < len(released(full).train)
    assert source.describe() != described


@pytest.mark.parametrize("change", [{"sensor": "ViTacTip+ViTacTip"}, {"sensor": "ViTacTip+"}, {"pattern": "+Blackdot"}])
def test_directory_that_is_named_twice_or_not_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    """An image would be there twice, or every directory would be read as one."""
    with refused(DataError, place=f"data.{next(iter(change))}", got="directories are named twice, or names are empty"):
        replace(save_release(tmp_path), **change).catalogue()
