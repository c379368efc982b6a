"""Promise: `tacevo replay --diff` meets whatever stands in a run's files with one line, and never a traceback."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from bundles import with_line

from tacevo.cli.app import main
from tacevo.records import Json

DEEP = b"[" * 100_000


def refused(run: Path, published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """See that the comparison ends in one line that names the user's directory."""
    assert main(["replay", str(run), "--diff", str(published / "run")]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith("error: ")


@pytest.mark.parametrize("name", ["ledger.jsonl", "run.json", "archive.json"])
@pytest.mark.parametrize("content", [DEEP, b"[]", b"5", b"null", b"\xff", b'{"a": NaN}'])
def test_file_of_nonsense_is_an_error(
    name: str, content: bytes, run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nesting that no parser follows among it."""
    (path,) = run.rglob(name)
    path.write_bytes(content + b"\n")
    refused(run, published, capsys)


EDITS: list[Callable[[dict[str, Json]], object]] = [
    lambda line: line.update(fitness="low"),
    lambda line: line.update(fitness=10**400),
    lambda line: line.pop("kind"),
]


@pytest.mark.parametrize("edit", EDITS)
def test_sealed_nonsense_is_an_error(
    edit: Callable[[dict[str, Json]], object], run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line may say anything under a hash that fits it."""
    members = {f"run/{name}": (run / name).read_bytes() for name in ("ledger.jsonl", "run.json")}
    for name, data in with_line(members, 1, edit).items():
        (run / name.removeprefix("run/")).write_bytes(data)
    refused(run, published, capsys)


def test_deep_settings_are_an_error(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As deep as a parser still follows, and a comparison does not."""
    shutil.copytree(run, tmp_path / "other")
    for folder, end in ((run, "1"), (tmp_path / "other", "2")):
        told = (folder / "run.json").read_text()
        deep = told.replace('"seed": 0', f'"seed": {"[" * 900}{end}{"]" * 900}', 1)
        assert deep != told
        (folder / "run.json").write_text(deep)
    assert main(["replay", str(run), "--diff", str(tmp_path / "other")]) == 2
    assert capsys.readouterr().err.startswith("error: ")
