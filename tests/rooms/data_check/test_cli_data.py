"""`tacevo data` as a user gives it: what is found is told, every mistake is one line, and nothing half-made stays."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image
from refusals import refused
from small_recordings import save_forces
from waiting import eventually

from tacevo.cli.app import _parsed, main
from tacevo.environment import as_typed
from tacevo.errors import ConfigError

COMMAND = [sys.executable, "-m", "tacevo.cli.app"]

SMALL = ["task=force", "data.images=40", "data.image_size=16"]


@pytest.fixture(autouse=True)
def _elsewhere(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a directory of the test's own, and draw two images on a sheet, which takes a tenth of the time of 40."""
    monkeypatch.setattr("tacevo.data.pictures.SHEET_IMAGES", 2)


def write_classes(root: Path, *, equal: int = 1) -> list[str]:
    """Write 40 images of two classes, of which so many at a time are equal; return the overrides that read them."""
    for number in range(40):
        path = root / "ab"[number % 2] / f"{number:02d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        image = Image.new("RGB", (20, 24), (number // equal, 9, 9))
        image.putpixel((3, 3), (200, 0, 0))
        image.save(path)
    return ["task=grating", "data=folder", f"data.root={root}", "task.outputs=2", "data.image_size=16"]


def test_check_reports_and_draws(capsys: pytest.CaptureFixture[str]) -> None:
    """Counts, ranges with units, fingerprint and the sheet's name are told; the sheet is there."""
    assert main(["data", "check", *SMALL]) == 0
    out = capsys.readouterr().out
    assert "40: 32 training, 4 validation, 4 test" in out
    assert re.search(r"Fz \[N\] +validation", out)
    assert "no two images are equal" in out
    (sheet,) = Path.cwd().glob("contact-sheet-*.png")
    assert f"look:        {sheet.name}" in out
    with Image.open(sheet) as image:
        assert image.width == 2148


def test_check_names_the_sensor_of_a_release(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Forces have no pattern, whatever the configuration holds for gratings."""
    rows = "".join(f"image_{number}.png,{number},{number},{number % 3}\n" for number in range(10))
    save_forces(tmp_path, rows, images=10)
    main(["data", "check", "task=force", "data=tacverse", f"data.root={tmp_path}", "data.image_size=16"])
    (line,) = re.findall(r"^source: .*", capsys.readouterr().out, flags=re.MULTILINE)
    assert "data.sensor=ViTacTip" in line
    assert "data.pattern" not in line


def test_check_in_json_is_for_machines(capsys: pytest.CaptureFixture[str]) -> None:
    """One object with the same facts, and nothing else on standard output."""
    overrides = write_classes(Path("photos"))
    assert main(["data", "check", *overrides, "--json", "-o", "sheet.svg"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["images"] == {"all": 40, "train": 32, "validation": 4, "test": 4}
    assert (told["recorded_size"], told["image_size"]) == ([20, 24], 16)
    assert [sum(row[part] for row in told["labels"]) for part in ("train", "validation", "test")] == [32, 4, 4]
    assert told["duplicates"] == []
    assert told["sheet"] == "sheet.svg"
    assert (Path(told["cache"]) / "images.npy").is_file()


def test_leak_is_listed_and_is_exit_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    """Equal images in two splits are named with their files."""
    overrides = write_classes(Path("photos"), equal=40)
    assert main(["data", "check", *overrides]) == 1
    out = capsys.readouterr().out
    assert "1 group of equal images, 1 of them in more than one split, which is a leak" in out
    assert "leak: row 0 photos/a/00.png (" in out


@pytest.mark.slow
def test_first_groups_of_equal_images_are_listed_and_the_others_counted(capsys: pytest.CaptureFixture[str]) -> None:
    """A hundred lines of them would hide what else was found; a machine gets them all."""
    overrides = write_classes(Path("photos"), equal=2)
    assert main(["data", "check", *overrides]) == 1
    out = capsys.readouterr().out
    assert "20 groups of equal images" in out
    assert len(re.findall(r"^  (?:leak: )?row \d+ ", out, re.MULTILINE)) == 18  # leaks, 10 of them
    assert "more; --json lists all" in out
    assert main(["data", "check", *overrides, "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)["duplicates"]) == 20


def test_overrides_may_stand_behind_options(capsys: pytest.CaptureFixture[str]) -> None:
    """Where an override stands does not matter; a word that is none is still refused."""
    assert main(["data", "check", "task=force", "-o", "sheet.png", *SMALL[1:]]) == 0
    assert "40: 32 training" in capsys.readouterr().out
    for strange in ("--bogus", "sheet"):
        assert main(["data", "check", *SMALL, "--json", strange]) == 2
        assert f"unrecognized arguments: {strange}" in capsys.readouterr().err


@pytest.mark.slow
def test_check_tells_how_many_rows_were_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """A table that lacks images, loaded as asked for, says so in the report and in the JSON."""
    for number in range(20):
        Image.new("RGB", (20, 20), (number, 9, 9)).save(f"{number}.png")
    rows = "".join(f"{number}.png,{number},{number % 3},{number % 5}\n" for number in range(23))
    Path("labels.csv").write_text("image,a,b,c\n" + rows)
    settings = [
        "data=csv",
        "data.root=.",
        "data.target_columns=[a,b,c]",
        "data.image_size=16",
        "data.skip_missing=true",
    ]
    assert main(["data", "check", *settings]) == 0
    out = capsys.readouterr().out
    assert "left out:    3 rows whose image is missing" in out
    assert "a [unit unknown]" in out
    assert main(["data", "check", *settings, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["skipped"] == 3


@pytest.mark.slow
def test_check_uses_the_entry_of_a_search(capsys: pytest.CaptureFixture[str]) -> None:
    """What was loaded once is not made again, and is found where a search looks."""
    assert main(["data", "check", *SMALL]) == 0
    made = {path: path.stat().st_mtime_ns for path in Path("cache").rglob("*")}
    capsys.readouterr()
    assert main(["data", "show", *SMALL, "-o", "figure.pdf"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert {path: path.stat().st_mtime_ns for path in made} == made
    assert captured.out == "look: figure.pdf\n"
    assert Path("figure.pdf").read_bytes().startswith(b"%PDF")
    assert main(["data", "check", *SMALL, "task.outputs=2"]) == 2  # for another task it is still refused
    assert "set task.outputs=3" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("task", ["force", pytest.param("hardness", marks=pytest.mark.slow)])
def test_printed_command_reads_the_export(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What `simulate` prints works as it stands, and gives the fingerprint of the simulation."""
    assert main(["data", "simulate", f"task={task}", "n=40", "out=made", "data.image_size=16"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == "40 images and their labels: made"
    assert second.startswith(f"read them: {as_typed('tacevo')} data check ")
    fingerprints = []
    for command in (
        shlex.split(second)[3:],
        ["data", "check", f"task={task}", "data.images=40", "data.image_size=16"],
    ):
        assert main([*command, "--json"]) == 0
        fingerprints.append(json.loads(capsys.readouterr().out)["fingerprint"])
    assert fingerprints[0] == fingerprints[1]


def test_overrides_may_stand_in_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    """A file has one override a line, and may have comments and empty lines."""
    Path("mine.txt").write_text("# a small set\n\n" + "\n".join(SMALL) + "\n")
    assert main(["data", "check", "@mine.txt", "data.images=50", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images"]["all"] == 50


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["check", "task=grating", "data=folder", "data.root=absent"], "absent"),
        (["check", *SMALL, "task.outputs=2"], "set task.outputs=3"),
        (
            ["check", *SMALL, "-o", "sheet.gif"],
            "-o: expected a file name that ends in one of .png, .pdf, .svg; got sheet.gif",
        ),
        (["check", "sheet"], "expected KEY=VALUE or GROUP=CHOICE; got 'sheet'"),
        (["check", "data=folder", "data.root=~/photos"], "data.root=~/photos"),
        (["show", *SMALL, "-o", "absent/figure.pdf"], "-o: expected a file in a directory; got absent"),
        (["show", "data.imges=3", "-o", "figure.pdf"], "imges"),
        (["simulate", "task=force", "n=40"], "out: expected one new directory, as in out=DIR; got []"),
        (["simulate", "task=force", "n=4", "out=made"], "error: n: expected an integer of at least 10"),
        (
            ["simulate", "task=force", "n=40", "out=."],
            "out: expected a new directory, e.g. out=simulated; got ., which exists",
        ),
        (
            ["simulate", "data=folder", "data.root=x", "out=made"],
            "data: expected simulated, which alone is written as files; got folder",
        ),
    ],
)
def test_mistake_is_one_line_and_leaves_nothing(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message names the setting as it was written, and no picture or directory appears."""
    assert main(["data", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in Path.cwd().iterdir() if path.name != "cache"] == []


def test_directory_is_not_the_name_of_a_picture(capsys: pytest.CaptureFixture[str]) -> None:
    """However it is called; this is told before any image is made."""
    Path("sheet.png").mkdir()
    assert main(["data", "check", *SMALL, "-o", "sheet.png"]) == 2
    assert "-o: expected a file name; got sheet.png, which is a directory" in capsys.readouterr().err
    assert not Path("cache").exists()


@pytest.mark.slow
def test_ctrl_c_ends_an_export_and_leaves_nothing(tmp_path: Path) -> None:
    """Interrupted by a terminal while processes draw, neither a process nor a file remains."""
    arguments = ["data", "simulate", "task=force", "n=20000", "data.image_size=64", "out=made", "executor.workers=2"]
    making = subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert eventually(lambda: len(list(tmp_path.glob(".made-*/images/*.png"))) >= 100, seconds=60)
    assert making.poll() is None
    os.killpg(making.pid, signal.SIGINT)
    _, errors = making.communicate(timeout=60)
    assert making.returncode == 130
    assert errors.strip() == "interrupted; nothing half-made is left"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "command", "got"),
    [
        (["data", "check", "--bogus"], "tacevo data check", "unrecognized arguments: --bogus"),
        (["data", "simulate"], "tacevo data simulate", "the following arguments are required: SETTING"),
        (["data", "bogus"], "tacevo data", "expected one of check, show, simulate; got bogus"),
        (["cache", "verify", "--bogus"], "tacevo cache verify", "unrecognized arguments: --bogus"),
        (["--bogus", "doctor"], "tacevo doctor", "unrecognized arguments: --bogus"),
    ],
)
def test_bad_arguments_are_one_error_that_names_their_command(
    arguments: list[str], command: str, got: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Who mistypes an option of one command is shown the way to that command's help."""
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {command}: ")
    assert got in line
    assert line.endswith(f"`{command} --help` says what can be given")


@pytest.mark.parametrize(
    ("arguments", "place", "expected", "got", "remedy"),
    [
        (["serch"], "tacevo", "one of search, extend, ", "serch", "did you mean search?"),
        (["data", "shw"], "tacevo data", "one of check, show, simulate", "shw", "did you mean show?"),
        (
            *(["data", "show", "-o", "a.pdf", "--width", "dubble"], "tacevo data show --width"),
            *("one of single, double", "dubble", "did you mean double?"),
        ),
        (["search", "@none"], "@none", "a text file with one override a line", "cannot be read (No such file", ""),
    ],
)
def test_mistyped_choice_is_refused_with_the_nearest(
    arguments: list[str], place: str, expected: str, got: str, remedy: str
) -> None:
    """Of commands and of options; a file of overrides that is not there has the same form."""
    with refused(ConfigError, place=place, expected=expected, got=got, remedy=remedy):
        _parsed(arguments)


def test_file_of_overrides_that_is_no_text_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """Bytes that are not UTF-8 are a mistake, told without a traceback."""
    Path("sheet.png").write_bytes(b"\x89PNG\xff")
    assert main(["data", "check", "@sheet.png"]) == 2
    assert "a file of overrides (@FILE) must be text in UTF-8" in capsys.readouterr().err


def test_check_names_files_that_are_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    """Another format and loose images are counted and named, in words and for machines."""
    overrides = write_classes(Path("photos"))
    Image.new("RGB", (20, 24)).save("photos/a/40.bmp")
    Image.new("RGB", (20, 24)).save("photos/loose.png")
    assert main(["data", "check", *overrides]) == 0
    assert "ignored:     2 files outside the data set: photos/a/40.bmp, photos/loose.png" in capsys.readouterr().out
    assert main(["data", "check", *overrides, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ignored"] == ["photos/a/40.bmp", "photos/loose.png"]
