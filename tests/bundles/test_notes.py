"""Promise: what the makers of a run wrote in its NOTE.md stands wherever its readers look, and is published with it."""

import json
import shutil
from pathlib import Path

import pytest
from bundles import laid_out, members_of, resealed
from commands import publish
from refusals import refused

from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.storage.notes import LONGEST, read_note

LIMITS = "A model answered,\nwhich nobody can ask again.\n\n- One search.\n- One split."


@pytest.fixture
def noted(published: Path, tmp_path: Path) -> Path:
    """Return a copy of a finished run, with a note."""
    shutil.copytree(published / "run", tmp_path / "run")
    (tmp_path / "run" / "NOTE.md").write_text(LIMITS)
    return tmp_path / "run"


def test_paragraphs_and_items_are_told_apart(tmp_path: Path) -> None:
    """Line breaks of a paragraph are an editor's; the items of a list are sentences of their own."""
    (tmp_path / "NOTE.md").write_text(LIMITS)
    assert read_note(tmp_path) == ("A model answered, which nobody can ask again.", "One search.", "One split.")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"\xff", "text in UTF-8"),
        (b"x" * (LONGEST + 1), "at most 5,000 characters"),
        (b"\xff" * (4 * LONGEST + 1), "at most 5,000 characters"),  # refused by its size alone
    ],
)
def test_note_that_cannot_be_shown_is_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    """Its place is named."""
    (tmp_path / "NOTE.md").write_bytes(content)
    with refused(RunError, place="NOTE.md", expected=expected):
        read_note(tmp_path)


@pytest.mark.slow
def test_note_is_published_and_shown(noted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """README, metadata, citation, report and `tacevo show` have it; the bundle replays.

    One that no command could show is refused with its bundle, by whatever command opens it.
    """
    bundle = tmp_path / "run.zip"
    publish(str(noted), "-o", str(bundle))
    members = members_of(bundle)
    assert members["run/NOTE.md"].decode() == LIMITS
    told = "A model answered, which nobody can ask again."
    assert f"## What readers must know\n\n{told}\n\nOne search." in members["README.md"].decode()
    (root,) = (part for part in json.loads(members["ro-crate-metadata.json"])["@graph"] if part["@id"] == "./")
    assert told in root["description"]
    assert told in " ".join(members["CITATION.cff"].decode().split())
    assert main(["replay", str(bundle)]) == 0
    capsys.readouterr()
    for of in (noted, bundle):
        assert main(["show", str(of)]) == 0
        assert told in capsys.readouterr().out
    assert main(["report", str(bundle), "-o", str(tmp_path / "page.html")]) == 0
    assert told in (tmp_path / "page.html").read_text()
    bad = resealed(members | {"run/NOTE.md": b"\xff"}, tmp_path / "bad.zip")
    for command in ("show", "replay"):
        assert main([command, str(bad)]) != 0
        assert "NOTE.md: expected text in UTF-8" in capsys.readouterr().err


def test_note_cannot_draw_on_the_terminal(noted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bundle may be a stranger's."""
    (noted / "NOTE.md").write_text("wiped \x1b[2J\n\ndigest: 0000")
    assert main(["show", str(noted)]) == 0
    told = capsys.readouterr().out
    assert "\x1b" not in told
    assert r"wiped \x1b[2J" in told
    assert [line.split()[0] for line in told.splitlines() if "digest: " in line] == [">", "digest:"]


def test_note_of_a_stranger_shows_no_other_file(tmp_path: Path) -> None:
    """A link is not read."""
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "NOTE.md").symlink_to(tmp_path / "secret")
    assert read_note(tmp_path) == ()


@pytest.mark.slow
def test_note_of_a_sweep_is_published_with_it(swept: Path, tmp_path: Path) -> None:
    """It lies beside sweep.json, in the bundle, too, which replays and can be published again."""
    shutil.copytree(swept / "sweep", tmp_path / "sweep")
    (tmp_path / "sweep" / "NOTE.md").write_text(LIMITS)
    first, again = tmp_path / "sweep.zip", tmp_path / "again.zip"
    publish(str(tmp_path / "sweep"), "--store", str(swept / "cache"), "-o", str(first))
    members = members_of(first)
    assert members["sweep/NOTE.md"].decode() == LIMITS
    assert "\n\nOne search.\n\nOne split.\n" in members["README.md"].decode()
    assert main(["replay", str(first)]) == 0
    folder, store = laid_out(first, tmp_path / "laid out")
    publish(str(folder), "--store", str(store), "-o", str(again))
    assert again.read_bytes() == first.read_bytes()
