"""CSV tables: rows become labels and images in order; each kind of broken table is refused by its place."""

import os
import struct
import warnings
import zlib
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image
from refusals import refused
from small_recordings import loaded, save_image, save_table

from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError
from tacevo.storage.canonical import value_at

HEADER = "image_name, fx ,fz,note\n"


def test_images_may_lie_beside_a_table_in_a_subfolder(tmp_path: Path) -> None:
    """TacVerse keeps table and images together, below the root."""
    beside = save_table(tmp_path / "ViTacTip", "1.png,1,2,\n")
    catalogue = replace(beside, root=tmp_path, table="ViTacTip/labels.csv").catalogue()
    assert int(catalogue.pictures[0]()[0, 0, 0]) == 1
    assert catalogue.recorded_size == (8, 8)


@pytest.mark.parametrize(
    ("rows", "header", "labels"),
    [
        ("1.png,1,2,\n", "\ufeff" + HEADER, [2.0, 1.0]),
        ('"1.png", "1","2", "wet, 5"""\n', HEADER, [2.0, 1.0]),
        ("1.png,+1., .5 ,\n", HEADER, [0.5, 1.0]),
        ("1.png,-2E+2,1e-3,\n", HEADER, [0.001, -200.0]),
        ("1.png,1,2\n", "Image_Name,FX,Fz\n", [2.0, 1.0]),
        ("1.png,1,2,3\n", "image_name,FX,fz,fx\n", [2.0, 3.0]),
    ],
)
def test_sound_row_is_read(tmp_path: Path, rows: str, header: str, labels: list[float]) -> None:
    """With a spreadsheet's mark, quotes, numbers as people write them, columns in any case, the exact one first."""
    assert save_table(tmp_path, rows, header=header).catalogue().labels.tolist() == [labels]


#: Values that Python reads as numbers and a person may not, or that are none.
NO_NUMBERS = ("inf", "soft", "0x10", "\uff11\uff12", "1e999", "1.2.3", "--1", "1e", ".", "1 000", "x" * 1000)


@pytest.mark.parametrize(
    ("rows", "header", "place"),
    [
        *((f"0.png,1,2,\n1.png,{text},2,\n", HEADER, "line 3 fx = ") for text in NO_NUMBERS),
        ("0.png,nan,2,\n1.png,1,,\n2.png,1,soft,\n", HEADER, "(3 found): line 2 fx = 'nan', line 3 fz = '', line 4 fz"),
        ("".join(f"x{number}.png,1,2,\n" for number in range(40)), HEADER, "(40 found): line 2 'x0.png', line 3"),
        ("0.png,1,2,\n1.png,1,2,\n./0.png,3,4,\n", HEADER, "(1 found): line 4 './0.png'"),
        ("A.png,1,2,\na.PNG,1,2,\n", HEADER, "(1 found): line 3 'a.PNG'"),
        ("0.png,1,2,\n1.png,1,5,2,x\n2.png,1,2,3,4,5\n", HEADER, "its 4 columns (2 found): line 3, line 4"),
        ("0.png,1,2,\n\n9.png,1,2,\n", HEADER, "line 4 '9.png'"),
        ("0.png,1\n", HEADER, "line 2 fz = ''"),
        ('0.png,1,2,\n"1.png,1,2,\n2.png,1,2,\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,\n1.png,1,2,"wet\n2.png,1,2,dry"\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,\n1.png,"1"2,2,\n', HEADER, "labels.csv, line 3"),
        ('0.png,1,2,"' + "1.png,1,2,\n" * 20_000, HEADER, "labels.csv, line 2"),
        ("0.png,1,2\n", "image_name,force_x,fz\n", "expected 'fx'; got 'image_name', 'force_x', 'fz'"),
        ("0.png,1,2\n", "picture,fx,fz\n", "the columns of labels.csv: expected 'image_name'"),
        ("1.png,1,2,3\n", "image_name,fx,fz, fx\n", "several columns of one name (1 found): 'fx'"),
        ("1.png,1,2,3\n", "image_name,fz,FX,Fx\n", "expected 'fx'"),
        ("0.png,1,2\n", "image_name;fx;fz\n", "with commas between them"),
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


@pytest.mark.parametrize("content", [b"PK\x03\x04\xff\xfe\x00", "größe".encode("latin-1"), None])
def test_table_that_is_no_text_or_cannot_be_read_is_refused(tmp_path: Path, content: bytes | None) -> None:
    """A spreadsheet, or another encoding; and the memory of this process, which begins where nobody may read."""
    source = save_table(tmp_path, "")
    if content is None:
        (tmp_path / "labels.csv").unlink()
        (tmp_path / "labels.csv").symlink_to("/proc/self/mem")
    else:
        (tmp_path / "labels.csv").write_bytes(content)
    with refused(DataError, place="labels.csv", got="cannot be read" if content is None else "byte 0x"):
        source.catalogue()


def test_missing_images_are_left_out_only_where_that_is_asked_for(tmp_path: Path) -> None:
    """The error names the setting; with it the other rows stay, whatever the labels of those that go."""
    source = save_table(tmp_path, "0.png,1,2,\n9.png,3,nan,\n2.png,5,6,\n")
    with refused(DataError, got="(1 found): line 3 '9.png'", remedy="or leave them out with data.skip_missing=true"):
        source.catalogue()
    lenient = replace(source, skip_missing=True).catalogue()
    assert (lenient.labels.tolist(), lenient.skipped) == ([[2.0, 1.0], [6.0, 5.0]], 1)


def test_rows_that_are_left_out_enter_the_key(tmp_path: Path) -> None:
    """One image that once stands for the first row and once for the second gives two data sets."""
    first, second = (save_table(tmp_path / name, "0.png,1,2,\n1.png,3,4,\n", images=1) for name in ("one", "other"))
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
        assert "skip_missing" not in caught.value.remedy


def test_order_of_the_columns_enters_the_key(tmp_path: Path) -> None:
    """They are the outputs of a network."""
    source = save_table(tmp_path, "0.png,1,2,\n")
    assert source.describe() != replace(source, target_columns=("fx", "fz")).describe()


@pytest.mark.parametrize(
    ("change", "place", "remedy"),
    [
        ({"root": "sett"}, "data.root", "holds: set; did you mean {tmp}/set?"),
        ({"root": "SET"}, "data.root", "holds: set; did you mean {tmp}/set?"),
        ({"root": "set/0.png"}, "data.root", "{tmp}/set holds: 0.png"),
        ({"root": "set/inner/deeper"}, "data.root", "{tmp}/set holds: 0.png"),
        ({"table": "forces.csv"}, "data.table", "labels.csv"),
    ],
)
def test_wrong_place_says_what_is_there(tmp_path: Path, change: dict[str, str], place: str, remedy: str) -> None:
    """The last directory that is there is named, with what it holds and the nearest name."""
    source = save_table(tmp_path / "set", "0.png,1,2,\n")
    wrong = {key: tmp_path / value if key == "root" else value for key, value in change.items()}
    with refused(DataError, place=place, got=next(iter(change.values())), remedy=remedy.format(tmp=tmp_path)):
        replace(source, **wrong).describe()  # type: ignore[arg-type]


def test_closed_directory_is_not_called_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory that may not be listed is named with the reason."""
    monkeypatch.chdir(tmp_path)  # a relative path, which needs no permission above it
    Path("half").mkdir()
    Path("half").chmod(0o311)
    source = TableSource(root=Path("half/set"), table="a.csv", image_column="a", target_columns=("b",), image_size=16)
    own = os.geteuid()
    os.seteuid(65_534 if own == 0 else own)
    try:
        with refused(DataError, place="data.root", remedy="cannot be listed (Permission denied)"):
            source.describe()
    finally:
        os.seteuid(own)


def test_linked_images_are_looked_for_beside_the_links(tmp_path: Path) -> None:
    """What lies in the directory that the table means counts, not what lies where its links lead."""
    source = save_table(tmp_path / "set", "0.png,1,2,\n1.png,3,4,\n")
    save_image(tmp_path / "store" / "other.png", 9)
    for name in ("0.png", "1.png"):
        (tmp_path / "set" / name).rename(tmp_path / "store" / name)
        (tmp_path / "set" / name).symlink_to(tmp_path / "store" / name)
    assert source.catalogue().ignored == [tmp_path / "set" / "2.png"]


@pytest.mark.parametrize("fault", ["is damaged or cut off", "has damaged notes, EXIF or TIFF tags"])
def test_image_damaged_behind_its_header_is_named_by_line(tmp_path: Path, fault: str) -> None:
    """Only decoding finds the damage, of which Pillow may only warn; the message still gives the line, in words."""
    source = save_table(tmp_path, "".join(f"{number}.png,{number},{number % 3},\n" for number in range(12)))
    for number in range(12):
        Image.effect_noise((64, 64), 50).save(tmp_path / f"{number}.png")
    whole = (tmp_path / "4.png").read_bytes()
    exif = b"eXIf" + b"II*\0\x08\0\0\0\x05\0"  # five tags are announced, and none comes
    notes = struct.pack(">I", len(exif) - 4) + exif + struct.pack(">I", zlib.crc32(exif))
    (tmp_path / "4.png").write_bytes(whole[:1500] if "cut" in fault else whole[:-12] + notes + whole[-12:])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with refused(DataError, got=f"(1 found): line 6 '4.png' ({fault})", remedy="repair or remove them"):
            loaded(source, tmp_path / "cache", workers=2)
