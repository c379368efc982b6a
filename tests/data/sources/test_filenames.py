"""Promise: where a name and its file differ in case, Unicode form or ending, the message has the file's own name."""

import unicodedata
from dataclasses import replace
from pathlib import Path, PurePath

import numpy as np
import pytest
from checkout import SHARED
from refusals import refused
from small_recordings import save_arrays, save_folder, save_image, save_table

from tacevo.data.listing import doubtful_files
from tacevo.data.sources.filenames import hidden_part
from tacevo.data.sources.folder import Folder
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError

DECOMPOSED = unicodedata.normalize("NFD", "müll.png")

CASES = SHARED / "cases" / "data" / "names"


@pytest.mark.parametrize(
    ("asked", "own", "unseen"),
    [
        ("img_0.png", "IMG_0.PNG", ""),
        ("Images/a.png", "images/a.png", ""),
        ("müll.png", DECOMPOSED, ", in another Unicode form"),
        ("MÜLL.png", DECOMPOSED, ", in another Unicode form"),
        ("00", "00.png", ""),
        ("00.jpg", "00.jpeg", ""),
        ("press_0.5", "press_0.5.png", ""),
        ("deep/A", "deep/a.JPG", ""),
    ],
)
def test_missing_image_is_named_as_its_file_is(tmp_path: Path, asked: str, own: str, unseen: str) -> None:
    """Both names stand in the message, and that they differ where a reader does not see it."""
    source = save_table(tmp_path, f"0.png,1,2,\n{asked},3,4,\n", images=1)
    save_image(tmp_path / own, 9)
    with refused(
        DataError, got=f"(1 found): line 3 {asked!r} (there is {own!r}{unseen})", remedy="write names as they"
    ):
        source.describe()


def test_what_is_really_missing_is_told_beside(tmp_path: Path) -> None:
    """One image has another name, the other is not there; a name without an image's ending is not like one with."""
    source = save_table(tmp_path, "0.PNG,1,2,\ngone.png,3,4,\n1.csv,5,6,\n", images=2)
    with refused(DataError, got="line 2 '0.PNG' (there is '0.png'), line 3 'gone.png', line 4 '1.csv'"):
        source.describe()


def test_table_of_another_name_is_named_so_too(tmp_path: Path) -> None:
    """As its file is."""
    source = replace(save_table(tmp_path, "0.png,1,2,\n"), table="mu\u0308ll.csv")
    (tmp_path / "labels.csv").rename(tmp_path / "MÜLL.CSV")
    with refused(
        DataError, place="data.table", remedy=f"did you mean {tmp_path / 'MÜLL.CSV'}, in another Unicode form?"
    ):
        source.describe()


@pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not beside this checkout")
@pytest.mark.parametrize(("case", "asked", "own"), [("case", "img_00.png", "IMG_00.PNG"), ("noext", "00", "00.png")])
def test_cases_of_users_are_told(case: str, asked: str, own: str) -> None:
    """Tables of which no name is that of its file."""
    source = TableSource(
        root=CASES / case, table="labels.csv", image_column="image", target_columns=("fx",), image_size=16
    )
    with refused(DataError, got=f"(12 found): line 2 {asked!r} (there is {own!r}"):
        source.describe()


#: What systems, network drives and editors leave; the images among them are named.
LITTER = (
    *("__MACOSX/a/._1.png", "__MACOSX/2.png", "a/Thumbs.db", ".DS_Store", "a/desktop.ini", "a/._1.png", "a/.1.png"),
    *("@eaDir/1.png", "a/@eaDir/1.png/SYNOPHOTO_THUMB_M.jpg", "b/@EADIR/1.jpg", "#recycle/a/1.png", "@Recycle/1.png"),
    *("lost+found/1.png", "a/.thumbnails/1.png", "a/.ipynb_checkpoints/1-checkpoint.png", ".@__thumb/default1.png"),
    *("$RECYCLE.BIN/1.png", "System Volume Information/1.png", ".Trash-1000/files/1.png", "#snapshot/a/1.png"),
    *("@Recently-Snapshot/a/1.png", ".AppleDouble/1.png", "Network Trash Folder/1.png", "ehthumbs.db"),
)


@pytest.mark.parametrize("litter", LITTER)
def test_what_a_system_leaves_is_passed_over_and_its_images_are_named(tmp_path: Path, litter: str) -> None:
    """No copy, preview or stub is an image or a class; nor does it change which data set this is."""
    source = save_folder(tmp_path, "a/1.png", "b/1.png")
    before = source.describe()
    (tmp_path / litter).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / litter).write_text("no image")
    assert source.describe() == before
    catalogue = source.catalogue()
    assert catalogue.ignored == []
    said = " ".join(doubtful_files(catalogue, tmp_path))
    if litter.endswith(("png", "jpg")):
        assert len(catalogue.passed_over) == 1
        assert (str(hidden_part(PurePath(litter))) in said) or "._*" in said
    else:
        assert said == ""
    archive = save_arrays(tmp_path / "a.npz", **{litter: np.zeros(3)})
    assert len(archive.catalogue().labels) == 12


def test_honest_names_are_not_litter(tmp_path: Path) -> None:
    """A class may have a sign before its name, or be called like a part of what systems leave."""
    names = ("@home", "#1", "recycle", "thumbs", "lost", "system", "found", "_a", "eaDir", "recycled", "tmp")
    assert set(save_folder(tmp_path, *(f"{name}/1.png" for name in names)).catalogue().names) == set(names)


THUMBS = SHARED / "cases" / "round4" / "data" / "nas_thumbs"


@pytest.mark.skipif(not THUMBS.is_dir(), reason="the cases are not beside this checkout")
def test_thumbnails_of_a_drive_are_no_images() -> None:
    """36 images of three classes, and what is passed over is told."""
    catalogue = Folder(root=THUMBS, image_size=16).catalogue()
    assert (len(catalogue.labels), catalogue.names) == (36, ("cork", "felt", "slate"))
    (said,) = doubtful_files(catalogue, THUMBS)
    assert "@eaDir (3)" in said


def test_names_that_differ_in_unicode_form_alone_are_one(tmp_path: Path) -> None:
    """Two classes, two images and two rows of one name, as a copy between systems makes them."""
    composed = "müll.png"
    for name in (f"a/{composed}", f"a/{DECOMPOSED}", "b/1.png"):
        save_image(tmp_path / "images" / name, 1)
    with refused(DataError, got="of their names only (1 found)"):
        Folder(root=tmp_path / "images", image_size=16).describe()
    for name in (composed[:-4], DECOMPOSED[:-4]):
        save_image(tmp_path / "classes" / name / "1.png", 1)
    with refused(DataError, got="are there twice (1 found)"):
        Folder(root=tmp_path / "classes", image_size=16).describe()
    table = save_table(tmp_path / "table", f"{composed},1,2,\n{DECOMPOSED},3,4,\n", images=0)
    for name in (composed, DECOMPOSED):
        save_image(tmp_path / "table" / name, 1)
    with refused(DataError, got="lists images more than once (1 found)"):
        replace(table, skip_missing=True).describe()
