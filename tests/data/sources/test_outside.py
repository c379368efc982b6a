"""Promise: what is read lies in data.root; a name that leads out is refused by its line, a link that does is told."""

from dataclasses import replace
from pathlib import Path

import pytest
from refusals import refused
from small_recordings import loaded, save_folder, save_forces, save_gratings, save_image, save_table

from tacevo.data.listing import doubtful_files
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError


def outside(root: Path) -> list[str]:
    """Write an image that a table has no business with; name it in every way that leads there from `root/set`."""
    save_image(root / "private" / "x.png", 7)
    (root / "set" / "deep").mkdir(parents=True)
    (root / "set" / "away").symlink_to(root / "private")
    return [
        "../private/x.png",
        "deep/../../private/x.png",
        "./../private/x.png",
        "deep/../deep/../../private/./x.png",
        "../set/../private/x.png",
        "away/../private/x.png",
        str(root / "private" / "x.png"),
        f"{root}/set/../private/x.png",
        f"/{root}/private/x.png",
    ]


@pytest.mark.parametrize("number", range(9))
@pytest.mark.parametrize("skip_missing", [False, True])
def test_name_that_leads_out_is_refused_by_its_line(number: int, skip_missing: bool, tmp_path: Path) -> None:
    """By `..`, over a link and back, or as an absolute path; the error says how images elsewhere can be used."""
    name = outside(tmp_path)[number]
    source = replace(save_table(tmp_path / "set", f"0.png,1,2,\n{name},3,4,\n"), skip_missing=skip_missing)
    for act in (source.describe, source.catalogue):
        with refused(DataError, got="(1 found): line 3 ", remedy="set data.root") as caught:
            act()
        assert f"outside {tmp_path / 'set'}" in caught.value.got


def test_name_that_comes_back_is_inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also as an absolute path, below a root that is written with `..` or is a link."""
    rows = "deep/../0.png,1,2,\n./1.png,3,4,\n{root}/2.png,5,6,\n../set/3.png,7,8,\n"
    outside(tmp_path)
    save_table(tmp_path / "set", rows.format(root=tmp_path / "set"), images=4)
    (tmp_path / "other").symlink_to(tmp_path / "set")
    monkeypatch.chdir(tmp_path / "private")
    for root in (tmp_path / "set", Path("../set"), tmp_path / "other"):
        source = TableSource(
            root=root, table="labels.csv", image_column="image_name", target_columns=("fx",), image_size=16
        )
        catalogue = source.catalogue()
        assert catalogue.labels[:, 0].tolist() == [1, 3, 5, 7]
        assert catalogue.linked == []


def test_images_beside_the_tables_directory_are_reached_by_the_root_above(tmp_path: Path) -> None:
    """The way that the error tells: the same table, bytes and data set, with the root one higher."""
    rows = "".join(f"../images/{number}.png,{number},{number % 3},\n" for number in range(12))
    source = save_table(tmp_path / "tables", rows, images=0)
    for number in range(12):
        save_image(tmp_path / "images" / f"{number}.png", number)
    with refused(DataError, got="(12 found): line 2 '../images/0.png'", remedy="data.table may be below it"):
        source.catalogue()
    wider = replace(source, root=tmp_path, table="tables/labels.csv")
    assert len(loaded(wider, tmp_path / "cache").targets) == 12
    assert wider.catalogue().linked == []


def test_image_inside_goes_before_one_outside(tmp_path: Path) -> None:
    """A name may be meant from the root, or from the table's directory."""
    save_image(tmp_path / "images" / "0.png", 1)
    save_image(tmp_path / "set" / "images" / "0.png", 2)
    source = save_table(tmp_path / "set" / "tables", "../images/0.png,1,2,\n", images=0)
    catalogue = replace(source, root=tmp_path / "set", table="tables/labels.csv").catalogue()
    assert int(catalogue.pictures[0]()[0, 0, 0]) == 2


def test_links_that_lead_out_are_followed_and_told(tmp_path: Path) -> None:
    """They are the user's own: of an image or of a directory, in a table's directory and in that of a class."""
    save_image(tmp_path / "disk" / "1.png", 7)
    save_image(tmp_path / "disk" / "2.png", 8)
    table = save_table(tmp_path / "set", "0.png,1,2,\na.png,3,4,\naway/1.png,5,6,\nb.png,7,8,\n")
    (tmp_path / "set" / "a.png").symlink_to(tmp_path / "disk" / "2.png")
    (tmp_path / "set" / "b.png").symlink_to(tmp_path / "set" / "2.png")
    (tmp_path / "set" / "away").symlink_to(tmp_path / "disk")
    (said,) = doubtful_files(table.catalogue(), tmp_path / "set")
    assert said.startswith(f"outside {tmp_path / 'set'}")
    assert "2 images, line 3 'a.png', line 4 'away/1.png'" in said
    folder = save_folder(tmp_path / "classes", "a/1.png", "b/1.png")
    (tmp_path / "classes" / "c").symlink_to(tmp_path / "disk")
    (tmp_path / "classes" / "a" / "2.png").symlink_to(tmp_path / "disk" / "2.png")
    assert folder.catalogue().linked == ["a/2.png", "c/1.png", "c/2.png"]
    (tmp_path / "classes" / "b" / "3.png").symlink_to(tmp_path / "never fetched.png")
    with refused(DataError, got="3.png"):
        folder.catalogue()
    (tmp_path / "set" / "unnamed.png").symlink_to(tmp_path / "never fetched.png")
    table.catalogue()


@pytest.mark.room("tacverse")
@pytest.mark.parametrize("name", ["..", "../Other", "/", "ViTacTip/../.."])
def test_release_is_read_below_its_directory(name: str, tmp_path: Path) -> None:
    """A sensor or a pattern is the name of a directory, and the names in its table stay there."""
    save_image(tmp_path / "image_0.png", 1)
    forces = save_forces(tmp_path / "release", "image_0.png,1,2,3\n../../../image_0.png,1,2,3\n")
    with refused(DataError, got="line 3 '../../../image_0.png'"):
        forces.catalogue()
    with refused(DataError, place="data.sensor", expected="the name of a directory below"):
        replace(forces, sensor=name).catalogue()
    with refused(DataError, place="data.pattern", expected="the name of a directory below"):
        replace(save_gratings(tmp_path / "release", "0.5_1_1.png"), pattern=name).catalogue()
