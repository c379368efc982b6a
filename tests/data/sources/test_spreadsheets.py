"""Promise: a table is read as its spreadsheet meant it: empty rows, `sep=;`, decimal commas, a mark in front."""

from pathlib import Path

import pytest
from checkout import SHARED
from refusals import refused
from small_recordings import loaded, save_table

from tacevo.data.listing import doubtful_files
from tacevo.data.sources.table import TableSource
from tacevo.errors import DataError

HEADER = "image_name, fx ,fz,note\n"
PLAIN = [[2.5, 1.5], [-4.0, 3.0]]


@pytest.mark.parametrize(
    "text",
    [
        HEADER + "0.png,1.5,2.5,\n1.png,3,-4,\n",
        "sep=,\n" + HEADER + "0.png,1.5,2.5,\n1.png,3,-4,\n",
        "sep=;\nimage_name;fx;fz\n0.png;1.5;2.5\n1.png;3;-4\n",
        "\ufeffsep=;\r\nimage_name;fx;fz\r\n0.png;1,5;2,5\r\n1.png;3;-4\r\n",
        "SEP=;\nimage_name;fx;fz\n0.png;1,5;2,5\n1.png;3,0;-4,0\n",
        '"sep=;"\nimage_name;fx;fz\n"0.png";"1,5";"2,5"\n1.png;3;-4E0\n',
        "sep=;;;\nimage_name;fx;fz\n0.png;1.5;2.5\n1.png;3;-4\n",
        "sep=;,,\nimage_name,fx,fz\n0.png,1.5,2.5\n1.png,3,-4\n",
        "sep=\t\nimage_name\tfx\tfz\n0.png\t1,5\t2,5\n1.png\t3\t-4\n",
        "sep=|\nimage_name|fx|fz\n0.png|1.5|2.5\n1.png|3|-4\n",
        "sep=;\rimage_name;fx;fz\r0.png;1,5;2,5\r1.png;3;-4\r",
    ],
)
def test_first_line_of_a_spreadsheet_is_obeyed(text: str, tmp_path: Path) -> None:
    """The labels are those that the columns show, whatever stands between them."""
    source = save_table(tmp_path, "")
    (tmp_path / "labels.csv").write_text(text, encoding="utf-8", newline="")
    assert source.catalogue().labels.tolist() == PLAIN


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("image_name;fx;fz\n0.png;1,5;2,5\n", "begin the file with a line sep=;"),
        ("image_name\tfx\tfz\n0.png\t1\t2\n", r"begin the file with a line sep=\t"),
        ("sep=;\nimage_name,fx,fz\n0.png,1,2\n", "begin the file with a line sep=,"),
        ("sep=;\nimage_name;fx;fz\n0.png;1,5;2.5\n", "line 3 fx = '1,5'"),
        ("sep=;\nimage_name;fx;fz\n0.png;1,000,000;2\n", "line 3 fx = '1,000,000'"),
        ("sep=;\nimage_name;fx;fz\n0.png;1;2\n9.png;1;2\n", "line 4 '9.png'"),
        (HEADER + '0.png,"1,5",2,\n', "line 2 fx = '1,5'"),
        ("sep=;\n", "a first line that names the columns"),
    ],
)
def test_what_stays_unclear_is_refused_by_its_line(text: str, words: str, tmp_path: Path) -> None:
    """A comma beside a point may divide thousands; lines are counted as an editor does, the first one too."""
    source = save_table(tmp_path, "")
    (tmp_path / "labels.csv").write_text(text)
    with pytest.raises(DataError) as told:
        source.catalogue()
    assert words in str(told.value)


ROWS = "".join(f"{number}.png,{number},{number % 3},\n" for number in range(12))


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (f"{HEADER}{ROWS},,,\n,,,\n", "14, 15"),
        (f"{HEADER}{ROWS},,,,,,,,\n", "14"),
        (f"{HEADER}{ROWS} , ,\t,\n", "14"),
        (f'{HEADER}{ROWS}"","","",""\n', "14"),
        (f"{HEADER},,,\n{ROWS},,,\n", "2, 15"),
        (f",,,\n{HEADER}{ROWS}", "1"),
        (f"{HEADER}{ROWS}\n\n", ""),
    ],
)
def test_empty_rows_are_passed_over_and_said(text: str, lines: str, tmp_path: Path) -> None:
    """They are no images, and change nothing of the data set but the bytes of its table."""
    source = save_table(tmp_path / "set", ROWS, images=12)
    plain = loaded(source, tmp_path / "cache")
    (tmp_path / "set" / "labels.csv").write_text(text)
    catalogue = source.catalogue()
    assert (len(catalogue.labels), catalogue.skipped) == (12, 0)
    assert loaded(source, tmp_path / "cache").facts == plain.facts
    said = list(doubtful_files(catalogue, tmp_path / "set"))
    assert [words.partition(", line ")[2] for words in said] == ([lines] if lines else [])


def test_row_that_lacks_its_image_alone_is_not_empty(tmp_path: Path) -> None:
    """A value without an image is a mistake, and so is an image without values."""
    for row, words in ((",1,2,", "line 3 ''"), (",,,x", "line 3 ''"), ("1.png,,,", "line 3 fz = ''")):
        with refused(DataError, got=words):
            save_table(tmp_path, f"0.png,1,2,\n{row}\n").catalogue()


BLANK = SHARED / "cases" / "round4" / "data" / "blank_rows"


@pytest.mark.skipif(not BLANK.is_dir(), reason="the cases are not beside this checkout")
def test_empty_rows_of_a_user_are_passed_over() -> None:
    """Twelve images, and two rows that a spreadsheet added."""
    source = TableSource(
        root=BLANK, table="labels.csv", image_column="image", target_columns=("fx", "fy", "fz"), image_size=16
    )
    catalogue = source.catalogue()
    assert (len(catalogue.labels), list(catalogue.blank)) == (12, [14, 15])
