"""CSV tables: rows become labels and images in order; each kind of broken table has its own message."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from refusals import refused
from small_recordings import loaded, save_image, save_table

from tacevo.data.sources.table import Table
from tacevo.errors import DataError
from tacevo.storage.canonical import value_at

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


#: Values that Python reads as numbers and a person may not, or that are none.
NO_NUMBERS = ("nan", "inf", "", "soft", "1_000", "0x10", "\uff11\uff12", "1e999", "1.2.3", "--1", "1e", ".", "1 000")


@pytest.mark.parametrize(
    ("rows", "header", "place"),
    [
        *((f"0.png,1,2,\n1.png,{text},2,\n", HEADER, "line 3 fx = ") for text in NO_NUMBERS),
        ("0.png,nan,2,\n1.png,1,,\n2.png,1,soft,\n", HEADER, "(3 found): line 2 fx = 'nan', line 3 fz = '', line 4 fz"),
        ("0.png,1,2,\n9.png,1,2,\n8.png,1,2,\n", HEADER, "(2 found): line 3 '9.png', line 4 '8.png'"),
        ("".join(f"x{number}.png,1,2,\n" for number in range(40)), HEADER, "(40 found): line 2 'x0.png', line 3"),
        ("0.png,1,2,\n1.png,1,2,\n./0.png,3,4,\n", HEADER, "line 4 './0.png'"),
        ("0.png,1,2,\n0.png,1,2,\n0.png,3,4,\n", HEADER, "(2 found): line 3 '0.png', line 4 '0.png'"),
        ("A.png,1,2,\na.PNG,1,2,\n", HEADER, "line 3 'a.PNG'"),
        ("0.png,1,2,\n1.png,1,5,2,x\n2.png,1,2,3,4,5\n", HEADER, "its 4 columns (2 found): line 3, line 4"),
        ("0.png,1,2,\n\n9.png,1,2,\n", HEADER, "line 4 '9.png'"),
        ("bad\0name.png,1,2,\n", HEADER, "line 2 'bad\\x00name.png'"),
        (f"{'x' * 300}.png,1,2,\n", HEADER, "line 2 'xxx"),
        ("images\\0.png,1,2,\n", HEADER, "write their paths with / instead of"),
        ("0.png,1\n", HEADER, "line 2 fz = ''"),
        (",1,2,\n", HEADER, "line 2 ''"),
        ('0.png,1,2,\n"1.png,1,2,\n2.png,1,2,\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,\n1.png,1,2,"wet\n2.png,1,2,dry"\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,\n"1.png"s,1,2,\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,\n1.png,"1"2,2,\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,"' + "1.png,1,2,\n" * 20_000, HEADER, "labels.csv, line 2"),
        ('0.png,1,2,\n1.png,1,2,"', HEADER, "labels.csv, line 3"),
        ("0.png,1,2\n", "image_name,force_x,fz\n", "'fx' (data.target_columns); got 'image_name', 'force_x', 'fz'"),
        ("0.png,1,2\n", "picture,fx,fz\n", "'image_name' (data.image_column)"),
        ("1.png,1,2,3\n", "image_name,fx,fz, fx\n", "several columns of one name (1 found): 'fx'"),
        ("1.png,1,2,3\n", "image_name,fz,FX,Fx\n", "'fx'"),
        ("0.png,1,2\n", "image_name;fx;fz\n", "not semicolons"),
        ("0.png,1,2\n", "image_name\tfx\tfz\n", "not tabs"),
        ("0.png,1,2\n", "0.png,1.5,2\n", "add a first line that names the columns"),
        ("", "", "a first line that names the columns"),
        ("", HEADER, "a header without rows"),
    ],
)
def test_broken_table_is_refused_by_its_place(tmp_path: Path, rows: str, header: str, place: str) -> None:
    """Lines are numbered as an editor counts them; a quote or a decimal comma never swallows or shifts the others."""
    source = save_table(tmp_path, rows, header=header)
    for name in ("A.png", "a.PNG"):
        save_image(tmp_path / name, 0)
    with pytest.raises(DataError) as told:
        source.describe()
    assert place in str(told.value)
    assert len(str(told.value)) < 600


def test_column_is_found_in_any_case(tmp_path: Path) -> None:
    """`Image_Name, FX, Fz` are the asked columns; the exact name wins where both are there."""
    assert save_table(tmp_path, "1.png,1,2\n", header="Image_Name,FX,Fz\n").catalogue().labels.tolist() == [[2.0, 1.0]]
    both = save_table(tmp_path, "1.png,1,2,3\n", header="image_name,FX,fz,fx\n")
    assert both.catalogue().labels.tolist() == [[2.0, 3.0]]


def test_missing_images_are_left_out_only_where_that_is_asked_for(tmp_path: Path) -> None:
    """The error names the setting; with it the other rows stay."""
    source = save_table(tmp_path, "0.png,1,2,\n9.png,3,nan,\n2.png,5,6,\n")
    with refused(DataError, got="line 3 '9.png'", remedy="or leave them out with data.skip_missing=true") as caught:
        source.catalogue()
    assert caught.value.remedy.startswith("restore ")
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
    assert value_at(one, ("images",)) == value_at(other, ("images",))


def test_no_image_at_all_is_never_left_out(tmp_path: Path) -> None:
    """A table without any image is in the wrong place, and no setting is offered for that."""
    source = save_table(tmp_path, "7.png,1,2,\n8.png,3,4,\n")
    for chosen in (source, replace(source, skip_missing=True)):
        with refused(DataError, got=f"names images that are not in {tmp_path} (2 found)") as caught:
            chosen.catalogue()
        assert caught.value.remedy.endswith("remove these lines")


def test_mixed_sizes_and_unreadable_images_are_named_by_line(tmp_path: Path) -> None:
    """Both are found from the headers, before anything is decoded."""
    source = save_table(tmp_path, "0.png,1,2,\n1.png,3,4,\n2.png,5,6,\n")
    save_image(tmp_path / "1.png", 0, size=(8, 9))
    with refused(DataError, got="2 have 8x8 pixels (width x height), others not (1 found): line 3 '1.png' 8x9"):
        source.catalogue()
    (tmp_path / "2.png").write_text("no image")
    with refused(DataError, got="cannot be read (1 found): line 4 '2.png' (is not an image of a known format)"):
        source.catalogue()


def test_size_before_resizing_is_known(tmp_path: Path) -> None:
    """The catalogue tells what the images were."""
    assert save_table(tmp_path, "0.png,1,2,\n").catalogue().recorded_size == (8, 8)


@pytest.mark.parametrize(
    ("root", "remedy"),
    [
        ("sett", "holds: set; did you mean {tmp}/set?"),
        ("SET", "holds: set; did you mean {tmp}/set?"),
        ("set/0.png", "{tmp}/set holds: 0.png"),
        ("set/inner/deeper", "{tmp}/set holds: 0.png"),
    ],
)
def test_wrong_root_is_refused(tmp_path: Path, root: str, remedy: str) -> None:
    """The last directory that is there is named, with what it holds and the nearest name."""
    source = save_table(tmp_path / "set", "0.png,1,2,\n")
    remedy = remedy.format(tmp=tmp_path)
    with refused(DataError, place="data.root", expected="the table labels.csv", remedy=remedy):
        replace(source, root=tmp_path / root).describe()


def test_closed_directory_is_not_called_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory that may not be listed is named with the reason."""
    monkeypatch.chdir(tmp_path)  # a relative path, which needs no permission above it
    Path("half").mkdir()
    Path("half").chmod(0o311)
    source = Table(root=Path("half/set"), table="a.csv", image_column="a", target_columns=("b",), image_size=16)
    own = os.geteuid()
    os.seteuid(65_534 if own == 0 else own)
    try:
        with refused(DataError, place="data.root", remedy="cannot be listed (Permission denied)"):
            source.describe()
    finally:
        os.seteuid(own)


def test_missing_table_is_named(tmp_path: Path) -> None:
    """Without the table the error names the setting to change, and what is there."""
    source = save_table(tmp_path, "0.png,1,2,\n")
    with refused(DataError, place="data.table", got="forces.csv", remedy="labels.csv"):
        replace(source, table="forces.csv").describe()


@pytest.mark.parametrize("content", [b"PK\x03\x04\xff\xfe\x00", "größe".encode("latin-1")])
def test_table_that_is_no_text_is_refused(tmp_path: Path, content: bytes) -> None:
    """A spreadsheet file with the wrong name, or a table in another encoding, is not read as numbers."""
    source = save_table(tmp_path, "")
    (tmp_path / "labels.csv").write_bytes(content)
    with refused(DataError, place="labels.csv", expected="a CSV table in UTF-8"):
        source.catalogue()


def test_table_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    """The disk may fail while it is read; the memory of this process begins with an address that nobody reads."""
    source = save_table(tmp_path, "")
    (tmp_path / "labels.csv").unlink()
    (tmp_path / "labels.csv").symlink_to("/proc/self/mem")
    with refused(DataError, place="labels.csv", got="a file that cannot be read (Input/output error)"):
        source.catalogue()


def test_sound_quotes_are_read(tmp_path: Path) -> None:
    """A comma or a doubled quote within a quoted value is text."""
    rows = '"0.png",1,2,"wet, 5"""\n"1.png", "3","4", dry\n'
    assert save_table(tmp_path, rows).catalogue().labels.tolist() == [[2.0, 1.0], [4.0, 3.0]]


def test_numbers_are_read_as_people_write_them(tmp_path: Path) -> None:
    """Signs, points at either end, exponents and outer spaces are plain."""
    rows = "0.png,+1., .5 ,\n1.png,-2E+2,1e-3,\n"
    assert save_table(tmp_path, rows).catalogue().labels.tolist() == [[0.5, 1.0], [0.001, -200.0]]


def test_long_texts_are_cut(tmp_path: Path) -> None:
    """A value of a thousand characters does not fill the screen."""
    with refused(DataError, got="line 2 fx = 'xxx") as caught:
        save_table(tmp_path, f"0.png,{'x' * 1000},2,\n").describe()
    assert caught.value.got.endswith("xxx...'")
    assert len(str(caught.value)) < 250


def test_images_that_no_row_names_are_told(tmp_path: Path) -> None:
    """They are not part of the data set, and the catalogue says which they are."""
    source = save_table(tmp_path, "0.png,1,2,\n2.png,3,4,\n")
    assert [path.name for path in source.catalogue().ignored] == ["1.png"]


def test_linked_images_are_looked_for_beside_the_links(tmp_path: Path) -> None:
    """What lies in the directory that the table means counts, not what lies where its links lead."""
    source = save_table(tmp_path / "set", "0.png,1,2,\n1.png,3,4,\n")
    (tmp_path / "store").mkdir()
    save_image(tmp_path / "store" / "other.png", 9)
    (tmp_path / "set" / "0.png").rename(tmp_path / "store" / "kept.png")
    (tmp_path / "set" / "0.png").symlink_to(tmp_path / "store" / "kept.png")
    (tmp_path / "set" / "1.png").rename(tmp_path / "store" / "also.png")
    (tmp_path / "set" / "1.png").symlink_to(tmp_path / "store" / "also.png")
    assert source.catalogue().ignored == [tmp_path / "set" / "2.png"]


def test_image_damaged_behind_its_header_is_named_by_line(tmp_path: Path) -> None:
    """Only decoding finds the damage; the message still gives the line, in words."""
    source = save_table(tmp_path, "".join(f"{number}.png,{number},{number % 3},\n" for number in range(12)), images=12)
    noise = Image.effect_noise((64, 64), 50)
    for number in range(12):
        noise.save(tmp_path / f"{number}.png")
    whole = (tmp_path / "4.png").read_bytes()
    (tmp_path / "4.png").write_bytes(whole[: len(whole) // 2])
    got = "cannot be read (1 found): line 6 '4.png' (is damaged or cut off)"
    with refused(DataError, got=got, remedy="repair or remove them"):
        loaded(source, tmp_path / "cache")
