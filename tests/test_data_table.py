"""CSV tables: rows become labels and images in order; each kind of broken table has its own message."""

from dataclasses import replace
from pathlib import Path

import pytest
from small_recordings import save_image, save_table

from tacevo.data.table import Table
from tacevo.errors import DataError

HEADER = "image_name, fx ,fz,note\n"


def test_rows_keep_their_order_and_columns_the_asked_one(tmp_path: Path) -> None:
    """Targets come in the order of target_columns; spaces in the header and before values do not matter."""
    catalogue = save_table(tmp_path, "2.png,1.5,-1,x\n 0.png, 2.5,-2e0,\n").catalogue()
    assert catalogue.names == ("fz", "fx")
    assert catalogue.labels.tolist() == [[-1.0, 1.5], [-2.0, 2.5]]
    assert [int(picture()[0, 0, 0]) for picture in catalogue.pictures] == [2, 0]


def test_images_may_lie_beside_a_table_in_a_subfolder(tmp_path: Path) -> None:
    """TacVerse keeps table and images together, below the root."""
    save_table(tmp_path / "ViTacTip", "1.png,1,2,\n")
    source = Table(
        root=tmp_path, table="ViTacTip/labels.csv", image_column="image_name", target_columns=("fx",), image_size=16
    )
    assert int(source.catalogue().pictures[0]()[0, 0, 0]) == 1


def test_byte_order_mark_of_a_spreadsheet_is_ignored(tmp_path: Path) -> None:
    """Spreadsheets put three bytes before the first column's name."""
    assert save_table(tmp_path, "1.png,1,2,\n", header="\ufeff" + HEADER).catalogue().labels.tolist() == [[2.0, 1.0]]


def test_description_follows_content_and_not_place(tmp_path: Path) -> None:
    """A copy elsewhere is the same data set; an edited image or label makes another."""
    rows = "0.png,1,2,\n1.png,3,4,\n"
    here, there = save_table(tmp_path / "here", rows), save_table(tmp_path / "there", rows)
    assert here.describe() == there.describe()
    save_image(tmp_path / "there" / "1.png", 200)
    assert here.describe() != there.describe()
    assert here.describe() != save_table(tmp_path / "third", rows.replace("4", "5")).describe()
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
        ("0.png,1,2,\n0.png,1,2,\n0.png,3,4,\n", r"more than once \(2 found\): line 3 '0.png', line 4 '0.png'"),
        ("A.png,1,2,\na.PNG,1,2,\n", r"more than once \(1 found\): line 3 'a.PNG'. Keep one line per image; case"),
        ("0.png,1,2,\n1.png,1,5,2,x\n2.png,1,2,3,4,5\n", r"more values than its 4 columns \(2 found\): line 3, line 4"),
        ("0.png,1,2,\n\n9.png,1,2,\n", "line 4 '9.png'"),
        ("bad\0name.png,1,2,\n", r"line 2 'bad\\x00name.png'"),
        (f"{'x' * 300}.png,1,2,\n", "line 2 'xxx"),
        ("0.png,1\n", "line 2 fz = ''"),
        (",1,2,\n", "line 2 ''"),
    ],
    ids=[
        "missing image",
        "no number",
        "infinite",
        "duplicate by another path",
        "duplicate",
        "duplicate but for case",
        "decimal comma",
        "blank line",
        "impossible name",
        "long name",
        "short row",
        "no name",
    ],
)
def test_broken_rows_are_named_by_line(tmp_path: Path, rows: str, message: str) -> None:
    """The message gives the lines as an editor counts them, and how many there are."""
    source = save_table(tmp_path, rows)
    for name in ("A.png", "a.PNG"):
        save_image(tmp_path / name, 0)
    with pytest.raises(DataError, match=message):
        source.describe()


def test_many_broken_rows_are_cut_short(tmp_path: Path) -> None:
    """Five rows are shown and all are counted."""
    rows = "".join(f"x{number}.png,1,2,\n" for number in range(40))
    with pytest.raises(DataError, match=r"\(40 found\): .*line 6 'x4.png', \.\.\.\. Restore"):
        save_table(tmp_path, rows).describe()


def test_missing_columns_are_named_beside_those_that_exist(tmp_path: Path) -> None:
    """The user sees at once how the column is really called."""
    with pytest.raises(DataError, match=r"lacks columns \(1 found\): 'fx'. It has \['image_name', 'force_x', 'fz'\]"):
        save_table(tmp_path, "0.png,1,2\n", header="image_name,force_x,fz\n").catalogue()


def test_column_is_found_whatever_its_case(tmp_path: Path) -> None:
    """`Image_Name, FX, Fz` are the asked columns; the exact name wins where both are there."""
    assert save_table(tmp_path, "1.png,1,2\n", header="Image_Name,FX,Fz\n").catalogue().labels.tolist() == [[2.0, 1.0]]
    both = save_table(tmp_path, "1.png,1,2,3\n", header="image_name,FX,fz,fx\n")
    assert both.catalogue().labels.tolist() == [[2.0, 3.0]]


def test_columns_that_cannot_be_told_apart_are_refused(tmp_path: Path) -> None:
    """Two columns of one name, or two that differ from the asked one in case only, are no answer."""
    with pytest.raises(DataError, match=r"several columns of one name \(1 found\): 'fx'. Rename"):
        save_table(tmp_path, "1.png,1,2,3\n", header="image_name,fx,fz, fx\n").describe()
    with pytest.raises(DataError, match=r"lacks columns \(1 found\): 'fx'. It has \[.*'FX', 'Fx'"):
        save_table(tmp_path, "1.png,1,2,3\n", header="image_name,fz,FX,Fx\n").describe()


def test_missing_images_are_left_out_only_where_that_is_asked_for(tmp_path: Path) -> None:
    """The error names the setting; with it the other rows stay, whatever stands in those without an image."""
    source = save_table(tmp_path, "0.png,1,2,\n9.png,3,nan,\n2.png,5,6,\n")
    with pytest.raises(DataError, match=r"line 3 '9.png'. Restore .* or leave them out with data.skip_missing=true"):
        source.catalogue()
    lenient = replace(source, skip_missing=True)
    assert lenient.catalogue().labels.tolist() == [[2.0, 1.0], [6.0, 5.0]]
    assert lenient.catalogue().skipped == 1


def test_rows_that_are_left_out_enter_the_key(tmp_path: Path) -> None:
    """One image that once stands for the first row and once for the second gives two data sets."""
    first = save_table(tmp_path / "first", "0.png,1,2,\n1.png,3,4,\n", images=1)
    second = save_table(tmp_path / "second", "0.png,1,2,\n1.png,3,4,\n", images=1)
    (second.root / "0.png").rename(second.root / "1.png")
    one, other = (replace(source, skip_missing=True).describe() for source in (first, second))
    assert one != other
    assert one["images"] == other["images"]


def test_no_image_at_all_is_never_left_out(tmp_path: Path) -> None:
    """A table without any image is in the wrong place, and no setting is offered for that."""
    source = save_table(tmp_path, "7.png,1,2,\n8.png,3,4,\n")
    for chosen in (source, replace(source, skip_missing=True)):
        with pytest.raises(DataError, match=r"names images that are not in .*\(2 found\).*remove these lines\.$"):
            chosen.catalogue()


def test_mixed_sizes_and_unreadable_images_are_named_by_line(tmp_path: Path) -> None:
    """Both are found from the headers, before anything is decoded."""
    source = save_table(tmp_path, "0.png,1,2,\n1.png,3,4,\n2.png,5,6,\n")
    save_image(tmp_path / "1.png", 0, size=(8, 9))
    with pytest.raises(DataError, match=r"2 have 8x8 pixels .*\(1 found\): line 3 '1.png' 8x9"):
        source.catalogue()
    (tmp_path / "2.png").write_text("no image")
    with pytest.raises(DataError, match=r"cannot be read \(1 found\): line 4 '2.png' \(Unid"):
        source.catalogue()


def test_size_before_resizing_is_known(tmp_path: Path) -> None:
    """The catalogue tells what the images were."""
    assert save_table(tmp_path, "0.png,1,2,\n").catalogue().recorded_size == (8, 8)


@pytest.mark.parametrize("form", ["absent", "file"])
def test_wrong_root_is_refused(tmp_path: Path, form: str) -> None:
    """A root that is absent, or a file, is named."""
    source = save_table(tmp_path, "0.png,1,2,\n")
    root = tmp_path / ("elsewhere" if form == "absent" else "0.png")
    with pytest.raises(DataError, match=rf"data.root is no folder: {root}; give the folder that holds the recording"):
        replace(source, root=root).describe()


def test_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    """Without the table the message names the setting to change."""
    source = save_table(tmp_path, "0.png,1,2,\n")
    with pytest.raises(DataError, match=r"no table 'forces.csv' .*set data.table"):
        replace(source, table="forces.csv").describe()


@pytest.mark.parametrize("content", [b"PK\x03\x04\xff\xfe\x00", "größe".encode("latin-1")])
def test_table_that_is_no_text_is_refused(tmp_path: Path, content: bytes) -> None:
    """A spreadsheet file with the wrong name, or a table in another encoding, is not read as numbers."""
    source = save_table(tmp_path, "")
    (tmp_path / "labels.csv").write_bytes(content)
    with pytest.raises(DataError, match="no CSV table in UTF-8"):
        source.catalogue()


def test_empty_tables_are_refused(tmp_path: Path) -> None:
    """An empty file has no columns, and a header alone no images."""
    with pytest.raises(DataError, match=r"lacks columns \(3 found\)"):
        save_table(tmp_path, "", header="").catalogue()
    with pytest.raises(DataError, match="no rows below its header"):
        save_table(tmp_path, "").catalogue()
