"""Promise: images of one group never stand in two parts, which are as near to the asked sizes as groups let them."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from greys import Greys
from refusals import refused
from small_recordings import loaded, save_arrays, save_folder, save_gratings, save_image

from tacevo.choices import SplitRule
from tacevo.data import dataset as datasets
from tacevo.data.loading import split_rows
from tacevo.data.sources.image_files import groups_in
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError
from tacevo.parts.source import Catalogue

#: So many frames of each press.
UNEVEN = {"p1": 21, "p2": 3, "p3": 3, "p4": 1, "p5": 1, "p6": 1}


def save_presses(root: Path, frames: dict[str, int]) -> TableSource:
    """Write a table with a column of presses, in turn, and an image for each frame."""
    turns = sorted((frame, press) for press, count in frames.items() for frame in range(count))
    for number, (frame, press) in enumerate(turns):
        save_image(root / "images" / f"{press}_{frame}.png", number)
    lines = "".join(f"images/{press}_{frame}.png, {press} ,{number}\n" for number, (frame, press) in enumerate(turns))
    (root / "labels.csv").write_text(f"image,Press,depth\n{lines}")
    return TableSource(root=root, table="labels.csv", image_column="image", target_columns=("depth",), image_size=16)


def parts_of(catalogue: Catalogue, seed: int = 0, held_out: float = 0.1) -> list[np.typing.NDArray[np.int64]]:
    """Split at random; return the rows of each part."""
    parts = split_rows(catalogue, SplitRule.random, seed, (held_out, held_out))
    return [parts.train, parts.validation, parts.test]


def presses_in(catalogue: Catalogue, **how: Any) -> list[set[str]]:
    """Return the presses of each part, which the names of files begin with."""
    presses = [Path(path).as_posix().rpartition("_")[0] for path in catalogue.files or ()]
    return [{presses[row] for row in part} for part in parts_of(catalogue, **how)]


@pytest.mark.parametrize("chosen", [{"group_column": "press"}, {"group_pattern": r"(p\d+)_\d+\.png$"}])
def test_frames_of_a_press_stay_together_where_a_setting_says_so(tmp_path: Path, chosen: dict[str, Any]) -> None:
    """By a column, in any case, or a pattern on the path; without, the description is that of earlier versions."""
    plain = save_presses(tmp_path, UNEVEN)
    source = replace(plain, **chosen)
    for seed in range(3):
        held = presses_in(source.catalogue(), seed=seed)
        assert sum(map(len, held)) == len(set().union(*held)) == len(UNEVEN)
        assert [len(part) for part in parts_of(source.catalogue(), seed)] == [24, 3, 3]
    torn = presses_in(plain.catalogue())
    assert sum(map(len, torn)) > len(set().union(*torn))
    assert "group" not in str(plain.describe())
    assert source.describe() == {**plain.describe(), **chosen}  # type: ignore[dict-item]


def test_groups_of_directories_share_the_classes_out(tmp_path: Path) -> None:
    """Each class has presses of its own here; every part has each class, and no press twice."""
    names = [f"{kind}/press{row // 3}_{row % 3}.png" for kind in ("coarse", "fine") for row in range(24)]
    source = replace(save_folder(tmp_path, *names), group_pattern=r"^(\w+)/press(\d+)_")
    catalogue = source.catalogue()
    sizes = [Counter(catalogue.labels[part].tolist()) for part in parts_of(catalogue, held_out=0.25)]
    assert sizes == [{0: size, 1: size} for size in (12, 6, 6)]
    held = presses_in(catalogue, held_out=0.25)
    assert sum(map(len, held)) == len(set().union(*held)) == 16


def test_what_brackets_find_is_shared_or_else_all_that_is_found() -> None:
    """Several brackets count together; one that finds nothing is a value of its own; who finds none is named."""
    paths = ["a/1_x.png", "a/1_y.png", "b/1_x.png", "b/2_x.png"]
    assert groups_in(paths, r"^(\w)/(\d)").tolist() == [0, 0, 1, 2]
    assert groups_in(paths, r"\d").tolist() == [0, 0, 0, 1]
    assert groups_in(paths, r"^(b)?").tolist() == [1, 1, 0, 0]
    with refused(DataError, place="data.group_pattern", got="(2 found): 'b/1_x.png', 'b/2_x.png'"):
        groups_in(paths, "a")


def test_row_without_a_value_and_absent_column_are_named(tmp_path: Path) -> None:
    """A press without a name would be one with all others without."""
    source = replace(save_presses(tmp_path, UNEVEN), group_column="press")
    table = tmp_path / "labels.csv"
    table.write_text(table.read_text().replace("images/p5_0.png, p5 ,", "images/p5_0.png, ,"))
    with refused(DataError, got="without a value in press (1 found): line 6 'images/p5_0.png'"):
        source.catalogue()
    with refused(DataError, expected="'session'", got="'Press'", remedy="data.group_column"):
        replace(source, group_column="session").catalogue()


@pytest.mark.parametrize(
    ("setting", "value", "got"), [("group_column", "press", "2"), ("group_pattern", "images", "1")]
)
def test_too_few_groups_leave_a_part_empty_and_are_refused(tmp_path: Path, setting: str, value: str, got: str) -> None:
    """The message names the setting, and how many groups it gives."""
    source = replace(save_presses(tmp_path, {"p1": 9, "p2": 9}), **{setting: value})  # type: ignore[arg-type]
    with refused(DataError, place=f"data.{setting}", expected="at least 3 groups", got=got):
        loaded(source, tmp_path / "cache")


@pytest.mark.parametrize("seed", range(20))
def test_one_large_group_trains(seed: int) -> None:
    """Of all orders of three groups, one gives the wanted sizes, and it is found."""
    catalogue = Greys(count=30, groups=(0,) * 24 + (1,) * 3 + (2,) * 3).catalogue()
    assert [len(part) for part in parts_of(replace(catalogue, groups_chosen_by="data.group_column"), seed)] == [
        24,
        3,
        3,
    ]


def test_groups_of_an_archive_are_dealt_out_as_before(tmp_path: Path) -> None:
    """Its splits are older than the settings: one order, be it near to the wanted sizes or not."""
    catalogue = save_arrays(tmp_path / "a.npz", groups=np.array([0] * 8 + [1, 2, 3, 3])).catalogue()
    assert [part.tolist() for part in parts_of(catalogue, seed=1)] == [[8, 10, 11], [9], [0, 1, 2, 3, 4, 5, 6, 7]]
    assert [part.tolist() for part in parts_of(catalogue, seed=2)] == [[0, 1, 2, 3, 4, 5, 6, 7, 8], [10, 11], [9]]


@pytest.mark.parametrize(
    "chosen", [{"group_column": "press"}, {"group_pattern": r"(p\d+)_\d+\.png$"}, {}], ids=["column", "pattern", "none"]
)
def test_groups_of_the_test_images_are_recorded(tmp_path: Path, chosen: dict[str, Any]) -> None:
    """Numbered from 0 as they come, in the order of the rows; none where none are known. No name of a press stays."""
    source = replace(save_presses(tmp_path, {f"p{number}": 3 for number in range(20)}), **chosen)
    data = loaded(source, tmp_path / "cache")
    presses = [path.name.partition("_")[0] for path in source.catalogue().files or ()]
    tested = [presses[row] for row in data.test]
    expected = tuple(map(list(dict.fromkeys(tested)).index, tested)) if chosen else ()
    assert data.facts.groups == expected
    assert data.facts.units == (2 if chosen else 6)
    assert loaded(source, tmp_path / "cache").facts == data.facts


@pytest.mark.room("tacverse")
def test_groups_of_archives_and_presses_of_the_release_are_recorded(tmp_path: Path) -> None:
    """Whatever knows groups for the split knows them for the test."""
    archive = save_arrays(tmp_path / "a.npz", groups=np.array([7, 7, 7, 7, 3, 3, 3, 3, 5, 5, 9, 9]))
    assert loaded(archive, tmp_path / "cache").facts.units == 1
    names = [f"{size}_{press}_{frame}.png" for size in ("0.5", "1.0") for press in range(1, 6) for frame in range(2)]
    gratings = save_gratings(tmp_path / "release", *names)
    facts = loaded(gratings, tmp_path / "cache", split=SplitRule.release).facts
    assert facts.groups == (0, 0, 1, 1)


def test_data_set_that_an_earlier_release_made_gets_its_groups(tmp_path: Path) -> None:
    """No image is made again."""
    source = Greys(count=30, groups=tuple(number // 3 for number in range(30)))
    made = loaded(source, tmp_path)
    file = made.images.parent / datasets.GROUPS
    file.unlink()
    again = loaded(source, tmp_path, progress=lambda done, total: pytest.fail("an image was made"))
    assert again.facts == made.facts
    assert file.exists()


def test_damaged_groups_of_a_cached_data_set_are_refused(tmp_path: Path) -> None:
    """As any other file of it."""
    source = Greys(count=30, groups=tuple(number // 3 for number in range(30)))
    file = loaded(source, tmp_path).images.parent / datasets.GROUPS
    for groups in (np.array([0, 2, 2]), np.array([0, 0]), np.array([0.0, 0.0, 0.0]), np.array([[0, 0, 0]])):
        np.save(file, groups)
        with refused(DataError, place=datasets.GROUPS):
            loaded(source, tmp_path)
