"""The TacVerse layout: rows in the release's order, its own split, presses kept together, slips told by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from small_recordings import loaded, save_forces, save_gratings, save_image

from tacevo.choices import Normalisation, SensorTask, SplitRule, TargetScaling
from tacevo.data.loading import split_rows
from tacevo.data.source import Catalogue
from tacevo.data.sources.tacverse import TacVerse
from tacevo.data.splitting import Split
from tacevo.errors import DataError
from tacevo.records import Kind


def reds(catalogue: Catalogue) -> list[int]:
    """Decode every picture to its red, which tells which file it was."""
    return [int(picture()[0, 0, 0]) for picture in catalogue.pictures]


def released(catalogue: Catalogue) -> Split:
    """Take the release's own parts."""
    return split_rows(catalogue, SplitRule.release, seed=0)


def save_presses(root: Path, *, sizes: int, groups: int, frames: int) -> TacVerse:
    """Write a regular grating set, its sizes in steps of 0.5 mm."""
    names = [
        f"{size / 2}_{group}_{frame}.jpg"
        for size in range(1, sizes + 1)
        for group in range(1, groups + 1)
        for frame in range(frames)
    ]
    return save_gratings(root, *names)


def test_forces_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """10 comes after 9, for every order of the rows; spaces and case of the header do not matter."""
    rows = "image_10.png,1,2,3\nimage_9.png,4,5,6\nimage_0.png,7,8,9\n"
    source = save_forces(tmp_path, rows, images=11, header=" Image_Name , Fx ,FY, fz\n")
    catalogue = source.catalogue()
    assert reds(catalogue) == [0, 9, 10]
    assert catalogue.labels.tolist() == [[7, 8, 9], [4, 5, 6], [1, 2, 3]]
    assert (catalogue.kind, catalogue.names) == (Kind.regression, ("Fx", "Fy", "Fz"))
    assert (catalogue.groups, catalogue.recorded_size) == (None, (8, 8))


def test_release_states_no_units(tmp_path: Path) -> None:
    """Forces of the release may be in N or in mN, and are called neither."""
    assert save_forces(tmp_path, "image_0.png,1,2,3\n").catalogue().units is None


def test_columns_are_taken_by_name(tmp_path: Path) -> None:
    """Other columns, and another order of them, change nothing."""
    source = save_forces(tmp_path, "3,x,image_1.png,1,2\n", header="fz,note,image_name,fx,fy\n")
    assert source.catalogue().labels.tolist() == [[1, 2, 3]]


def test_release_splits_forces_in_their_order(tmp_path: Path) -> None:
    """The first round(0.6 N) images are for training, those up to round(0.8 N) for validation."""
    rows = "".join(f"image_{number}.png,{number},{number},{number}\n" for number in reversed(range(11)))
    catalogue = save_forces(tmp_path, rows, images=11).catalogue()
    parts = released(catalogue)
    assert catalogue.labels[parts.train, 0].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert catalogue.labels[parts.validation, 0].tolist() == [7, 8]
    assert catalogue.labels[parts.test, 0].tolist() == [9, 10]


def test_hardness_is_read_but_has_no_split_of_its_own(tmp_path: Path) -> None:
    """The form is ours, so no release says how to split it."""
    save_forces(tmp_path, "")
    folder = tmp_path / "Hardness_Regression"
    (tmp_path / "Force_Regression").rename(folder)
    (folder / "ViTacTip" / "ViTacTip.csv").write_text("image_name,shore\nimage_1.png,20\nimage_0.png,17.5\n")
    catalogue = TacVerse(
        root=tmp_path, task=SensorTask.hardness, sensor="ViTacTip", pattern=None, image_size=16
    ).catalogue()
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


def test_hidden_files_are_no_images(tmp_path: Path) -> None:
    """A system's stub beside an image is neither read nor refused for its name."""
    source = save_gratings(tmp_path, "0.5_1.png", "1_1.png", "._0.5_1.png", ".0.5_2.png")
    assert len(source.catalogue().pictures) == 2


def test_release_splits_25_presses_as_the_authors_do(tmp_path: Path) -> None:
    """Presses 1-15 of each size are for training, 16-20 for validation, 21-25 for the test."""
    catalogue = save_presses(tmp_path, sizes=2, groups=25, frames=2).catalogue()
    parts = released(catalogue)
    assert catalogue.groups is not None
    press = catalogue.groups % 25 + 1
    assert set(press[parts.train]) == set(range(1, 16))
    assert set(press[parts.validation]) == set(range(16, 21))
    assert set(press[parts.test]) == set(range(21, 26))
    assert [len(part) for part in (parts.train, parts.validation, parts.test)] == [60, 20, 20]


def test_release_takes_the_presses_that_there_are(tmp_path: Path) -> None:
    """Numbers may have gaps and sizes different counts: each size is cut at its own 60 % and 80 %."""
    names = [f"0.5_{group}.png" for group in (3, 7, 20, 21, 40)] + [f"1_{group}.png" for group in range(10)]
    catalogue = save_gratings(tmp_path, *names).catalogue()
    parts = released(catalogue)
    assert parts.train.tolist() == [0, 1, 2, 5, 6, 7, 8, 9, 10]
    assert parts.test.tolist() == [4, 13, 14]


@pytest.mark.parametrize("rule", SplitRule)
@pytest.mark.parametrize("seed", range(10))
def test_frames_of_a_press_never_straddle(tmp_path: Path, rule: SplitRule, seed: int) -> None:
    """Under either rule every press is in one part, and every size in all three."""
    catalogue = save_presses(tmp_path, sizes=3, groups=12, frames=3).catalogue()
    parts = split_rows(catalogue, rule, seed)
    assert catalogue.groups is not None
    held = [set(catalogue.groups[part].tolist()) for part in (parts.train, parts.validation, parts.test)]
    assert sum(map(len, held)) == 36
    assert len(set().union(*held)) == 36


def test_too_few_presses_are_refused(tmp_path: Path) -> None:
    """Two presses of a size leave none for the test; nothing is decoded to find that."""
    source = save_presses(tmp_path, sizes=2, groups=2, frames=5)
    with refused(DataError, place="the test split", got="no images of 2 of 2 classes (0.5 mm, 1 mm)"):
        loaded(source, tmp_path / "cache", split=SplitRule.release)


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; an edited image, label or name makes another."""
    rows = "image_0.png,1,2,3\nimage_1.png,4,5,6\n"
    here, there = save_forces(tmp_path / "here", rows), save_forces(tmp_path / "there", rows)
    assert here.describe() == there.describe()
    assert here.describe() != save_forces(tmp_path / "third", rows.replace("6", "7")).describe()
    save_image(tmp_path / "there" / "Force_Regression" / "ViTacTip" / "image_1.png", 99)
    assert here.describe() != there.describe()
    one, other = (save_gratings(tmp_path / name, f"{name}_1.png", "3_1.png") for name in ("1", "2"))
    assert one.describe() != other.describe()


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ("image_0.png,1,2,3\nimage_9.png,1,2,3\n", "Force_Regression/ViTacTip (1 found): line 3 'image_9.png'"),
        (
            "image_0.png,nan,2,3\nimage_1.png,1,,3\nimage_2.png,1,2,inf\n",
            "(3 found): line 2 fx = 'nan', line 3 fy = ''",
        ),
        ("image_0.png,1,2,3\nimage_0.png,1,2,3\n", "line 3 'image_0.png'"),
        ("image_0.png,1,2,3\n./image_0.png,1,2,3\n", "line 3 './image_0.png'"),
        ("plain.png,1,2,3\n", "line 2 'plain.png'; end names with their number"),
        ("", "ViTacTip.csv: expected a row for each image"),
    ],
    ids=["missing image", "no number", "duplicate", "duplicate by another path", "no numeric suffix", "empty"],
)
def test_broken_rows_are_named_by_line(tmp_path: Path, rows: str, place: str) -> None:
    """Every kind of broken row has its place."""
    source = save_forces(tmp_path, rows)
    save_image(tmp_path / "Force_Regression" / "ViTacTip" / "plain.png", 0)
    with pytest.raises(DataError) as told:
        source.describe()
    assert place in str(told.value)


def test_absent_label_column_is_named(tmp_path: Path) -> None:
    """A setting cannot change the layout's names."""
    with refused(DataError, expected="'fz' (TacVerse's layout)", got="'image_name', 'fx', 'fy'"):
        save_forces(tmp_path, "image_0.png,1,2\n", header="image_name,fx,fy\n").describe()


def test_missing_images_are_left_out_where_that_is_asked_for(tmp_path: Path) -> None:
    """As the release's own code does; the split counts the images that are there."""
    rows = "".join(f"image_{number}.png,{number},0,0\n" for number in range(20))
    source = replace(save_forces(tmp_path, rows, images=10), skip_missing=True)
    catalogue = source.catalogue()
    assert reds(catalogue) == list(range(10))
    assert released(catalogue).test.tolist() == [8, 9]


@pytest.mark.parametrize("task", [SensorTask.force, SensorTask.grating])
def test_mixed_sizes_and_unreadable_images_are_named(tmp_path: Path, task: SensorTask) -> None:
    """Both are found from the headers, before anything is decoded."""
    if task is SensorTask.force:
        source = save_forces(tmp_path, "".join(f"image_{number}.png,1,2,3\n" for number in range(3)))
        folder, names = tmp_path / "Force_Regression" / "ViTacTip", ("image_1.png", "image_2.png")
        places = ("line 3 'image_1.png'", "line 4 'image_2.png'")
    else:
        source = save_gratings(tmp_path, "1_1.png", "1_2.png", "2_1.png")
        folder, names = tmp_path / "Grating_Classification" / "ViTacTip" / "Blackdot", ("1_2.png", "2_1.png")
        places = names
    save_image(folder / names[0], 0, size=(9, 8))
    with refused(DataError, got=f"2 have 8x8 pixels (width x height), others not (1 found): {places[0]} 9x8"):
        source.catalogue()
    (folder / names[1]).write_text("no image")
    with refused(DataError, got=f"cannot be read (1 found): {places[1]} (is not an image of"):
        source.catalogue()


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
    ids=["absent", "file", "too high", "too deep", "empty", "sensor", "misspelt", "pattern", "no pattern"],
)
def test_wrong_place_says_what_is_there(tmp_path: Path, change: dict[str, str | None], place: str, remedy: str) -> None:
    """The error names the setting, what is there instead, and the nearest name."""
    source = save_gratings(tmp_path / "release", "1_1.png", "2_1.png")
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    wrong = {key: tmp_path / str(value) if key == "root" else value for key, value in change.items()}
    with refused(DataError, place=place, remedy=remedy):
        replace(source, **wrong).describe()  # type: ignore[arg-type]


def test_missing_table_is_named(tmp_path: Path) -> None:
    """Images without a table have no labels."""
    source = save_forces(tmp_path, "")
    (tmp_path / "Force_Regression" / "ViTacTip" / "ViTacTip.csv").unlink()
    with refused(DataError, expected="a table beside the images", got="ViTacTip.csv"):
        source.describe()


def test_pixels_reach_the_data_set_in_order(tmp_path: Path) -> None:
    """What `load` keeps is what the files hold."""
    source = save_forces(tmp_path, "".join(f"image_{n}.png,{n},{n},{n}\n" for n in range(12)), images=12)
    changes = {"normalisation": Normalisation.unit, "target_scaling": TargetScaling.none}
    dataset = loaded(source, tmp_path / "cache", split=SplitRule.release, **changes)
    assert np.load(dataset.images)[:, 0, 0, 0].tolist() == list(range(12))
    assert dataset.facts.counts == (7, 3, 2)
