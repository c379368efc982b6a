"""Promise: a deposit has all that a research archive asks for, and nothing that the user laid beside it is lost."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from commands import publish

from tacevo.bundles.deposit import deposit, doi_of
from tacevo.cli.app import main

pytestmark = [pytest.mark.timeout(300), pytest.mark.room("publishing")]


@pytest.fixture
def bundle(published: Path, place: Path) -> Path:
    """Return a published run where the test works."""
    return Path(shutil.copy(published / "run.zip", place / "run.zip"))


def test_deposit_is_complete_and_its_checksums_hold(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The bundle with its papers, and metadata that name authors, licence, day and the digest that is cited."""
    publish("run", "-o", "run.zip", "--author", "Ada Lovelace", "--license", "CC0-1.0", "--deposit", "out")
    digest = capsys.readouterr().out.splitlines()[-1].removeprefix("digest: ")
    names = {path.name for path in Path("out").iterdir()}
    assert names == {"run.zip", "README.md", "LICENSE.txt", "CITATION.cff", ".zenodo.json", "SHA256SUMS"}
    subprocess.run(["sha256sum", "--check", "--quiet", "--strict", "SHA256SUMS"], cwd="out", check=True)
    metadata = json.loads(Path("out/.zenodo.json").read_text())
    assert metadata["creators"] == [{"name": "Ada Lovelace"}]
    assert (metadata["license"], metadata["version"]) == ("cc0-1.0", digest)
    assert Path("out/run.zip").read_bytes() == Path("run.zip").read_bytes()


def test_second_deposit_replaces_the_files_of_the_first_alone(bundle: Path) -> None:
    """What the user laid there stays."""
    deposit(bundle, Path("out"))
    Path("out/notes.txt").write_text("mine")
    bundle.rename("other.zip")
    deposit(Path("other.zip"), Path("out"))
    assert not Path("out/run.zip").exists()
    assert Path("out/other.zip").exists()
    assert Path("out/notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--deposit", "out"], "--author: expected an author"),
        (["--deposit", "run", "--author", "A. Nyone"], "--deposit: expected an empty directory"),
    ],
)
def test_what_a_deposit_lacks_is_told_before_the_work(
    options: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No author; a directory in which something else lies. Nothing is published then."""
    assert main(["publish", "run", "-o", "run.zip", *options]) == 2
    assert said in capsys.readouterr().err
    assert not Path("run.zip").exists()


def test_doi_stands_beside_the_bundle(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is known after the digests are, so a replay tells it and no byte of the bundle changes."""
    Path("run.zip.doi").write_text("https://doi.org/10.5281/zenodo.1234567\n")
    assert doi_of(bundle) == "10.5281/zenodo.1234567"
    assert main(["replay", "run.zip"]) == 0
    assert "\ndoi: 10.5281/zenodo.1234567, as run.zip.doi says\n" in capsys.readouterr().out
    Path("run.zip.doi").write_bytes(b"\x1b[2J\xff no number")
    assert doi_of(bundle) is None
