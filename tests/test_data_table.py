"""CSV tables: rows become labels and images in order; each kind of broken table has its own message."""

from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from tacevo.data.table import Table
from tacevo.errors import DataError

HEADER = "image_name, fx ,fz,note\n"


def make(root: Path, rows: str, *, images: int = 3, header: str = HEADER) -> Table:
    """Write a table and images named 0.png, 1.png, ... into a folder."""
    root.mkdir(parents=True, exist_ok=True)
    (root / "labels.csv").write_text(header + rows)
    for number in range(images):
        Image.new("L", (4, 4), number).save(root / f"{number}.png")
    return Table(root=root, table="labels.csv", image_column="image_name", target_columns=("fz", "fx"), image_size=4)


def test_rows_keep_their_order_and_columns_the_asked_one(tmp_path: Path) -> None:
    """Targets come in the order of target_columns; spaces in the header and before values do not matter."""
    catalogue = make(tmp_path, "2.png,1.5,-1,x\n 0.png, 2.5,-2e0,\n").catalogue()
    assert catalogue.names == ("fz", "fx")
    assert catalogue.labels.tolist() == [[-1.0, 1.5], [-2.0, 2.5]]
    assert [int(picture()[0, 0, 0]) for picture in catalogue.pictures] == [2, 0]


def test_images_may_lie_beside_a_table_in_a_subfolder(tmp_path: Path) -> None:
    """TacVerse keeps table and images together, below the root."""
    make(tmp_path / "ViTacTip", "1.png,1,2,\n")
    source = Table(
        root=tmp_path, table="ViTacTip/labels.csv", image_column="image_name", target_columns=("fx",), image_size=4
    )
    assert int(source.catalogue().pictures[0]()[0, 0, 0]) == 1


def test_byte_order_mark_of_a_spreadsheet_is_ignored(tmp_path: Path) -> None:
    """Spreadsheets put three bytes before the first column's name."""
    assert make(tmp_path, "1.png,1,2,\n", header="\ufeff" + HEADER).catalogue().labels.tolist() == [[2.0, 1.0]]


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; an edited image or label makes another."""
    rows = "0.png,1,2,\n1.png,3,4,\n"
    here, there = make(tmp_path / "here", rows), make(tmp_path / "there", rows)
    assert here.describe() == there.describe()
    Image.new("L", (4, 4), 200).save(tmp_path / "there" / "1.png")
    assert here.describe() != there.describe()
    assert here.describe() != make(tmp_path / "third", rows.replace("4", "5")).describe()
    assert here.describe() != replace(here, target_columns=("fx", "fz")).describe()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0.png,1,2,\n9.png,1,2,\n8.png,1,2,\n", r"\(2 found\): line 3 '9.png', line 4 '8.png'. Restore them"),
        (
            "0.png,nan,2,\n1.png,1,,\n2.png,1,soft,\n",
            r"\(3 found\): line 2 fx = 'nan', line 3 fz = '', line 4 fz = 'so",
        ),
        ("0.png,inf,2,\n", "line 2 fx = 'inf'"),
        ("0.png,1,2,\n1.png,1,2,\n./0.png,3,4,\n", r"more than once \(1 found\): line 4 './0.png'"),
        ("0.png,1\n", "line 2 fz = ''"),
        (",1,2,\n", "line 2 ''"),
    ],
    ids=["missing image", "no number", "infinite", "duplicate", "short row", "no name"],
)
def test_broken_rows_are_named_by_line(tmp_path: Path, rows: str, message: str) -> None:
    """The message gives the lines as an editor counts them, and how many there are."""
    with pytest.raises(DataError, match=message):
        make(tmp_path, rows).catalogue()


def test_many_broken_rows_are_cut_short(tmp_path: Path) -> None:
    """Five rows are shown and all are counted."""
    rows = "".join(f"x{number}.png,1,2,\n" for number in range(40))
    with pytest.raises(DataError, match=r"\(40 found\): .*line 6 'x4.png', \.\.\.\. Restore"):
        make(tmp_path, rows).describe()


def test_missing_columns_are_named_beside_those_that_exist(tmp_path: Path) -> None:
    """The user sees at once how the column is really called."""
    with pytest.raises(DataError, match=r"lacks columns \(1 found\): 'fx'. It has \['image_name', 'force_x', 'fz'\]"):
        make(tmp_path, "0.png,1,2\n", header="image_name,force_x,fz\n").catalogue()


def test_missing_root_and_missing_table_are_told_apart(tmp_path: Path) -> None:
    """Each message names the setting to change."""
    source = make(tmp_path, "0.png,1,2,\n")
    with pytest.raises(DataError, match=r"data.root is no folder: .*elsewhere"):
        replace(source, root=tmp_path / "elsewhere").describe()
    with pytest.raises(DataError, match=r"no table 'forces.csv' .*set data.table"):
        replace(source, table="forces.csv").describe()


def test_table_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """A spreadsheet file with the wrong name is not read as numbers."""
    source = make(tmp_path, "")
    (tmp_path / "labels.csv").write_bytes(b"PK\x03\x04\xff\xfe\x00")
    with pytest.raises(DataError, match="no CSV table in UTF-8"):
        source.catalogue()


def test_empty_table_is_refused(tmp_path: Path) -> None:
    """An empty file has no columns."""
    with pytest.raises(DataError, match=r"lacks columns \(3 found\)"):
        make(tmp_path, "", header="").catalogue()
