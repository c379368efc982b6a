"""Promise: a deposit has all that a research archive asks for, and nothing that the user laid beside it is lost."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from commands import publish
from refusals import refused

from tacevo.bundles.deposit import deposit, doi_of
from tacevo.cli.app import main
from tacevo.errors import BundleError

pytestmark = [pytest.mark.timeout(300), pytest.mark.room("publishing")]


@pytest.fixture
def bundle(published: Path, place: Path) -> Path:
    """Return a published run where the test works."""
    return Path(shutil.copy(published / "run.zip", place / "run.zip"))


def sha256(path: Path) -> str:
    """Hash a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_deposit_is_complete_and_its_checksums_hold(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The bundle with its papers, and metadata that name authors, licence, day and the digest that is cited."""
    publish("run", "-o", "run.zip", "--author", "Ada Lovelace", "--license", "CC0-1.0", "--deposit", "out")
    digest = capsys.readouterr().out.splitlines()[-1].removeprefix("digest: ")
    names = {path.name for path in Path("out").iterdir()}
    assert names == {"run.zip", "README.md", "LICENSE.txt", "CITATION.cff", ".zenodo.json", "SHA256SUMS"}
    sums = {line[66:]: line[:64] for line in Path("out/SHA256SUMS").read_text().splitlines()}
    assert sums == {name: sha256(Path("out") / name) for name in names - {"SHA256SUMS"}}
    metadata = json.loads(Path("out/.zenodo.json").read_text())
    assert metadata["creators"] == [{"name": "Ada Lovelace"}]
    assert (metadata["license"], metadata["version"]) == ("cc0-1.0", digest)
    assert Path("out/run.zip").read_bytes() == Path("run.zip").read_bytes()


def test_file_that_is_no_bundle_is_refused(place: Path) -> None:
    """And a bundle without an author, whom no archive takes."""
    (place / "no.zip").write_bytes(b"PK")
    (place / "out").mkdir()
    with refused(BundleError, place="no.zip", expected="a bundle that was published with an author"):
        deposit(Path("no.zip"), Path("out"))
    assert [*(place / "out").iterdir()] == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--deposit", "out"], "--author: expected an author"),
        (["--deposit", "run", "--author", "A. Nyone"], "--deposit: expected a new or an empty directory"),
        (["--deposit", "run/run.json", "--author", "A. Nyone"], "--deposit: expected a new or an empty directory"),
        (["--deposit", "out", "--author", "A. Nyone", "-o", "README.md"], "--output: expected another name"),
    ],
)
def test_what_a_deposit_lacks_is_told_before_the_work(
    options: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No author, a directory with files, a file in its place, a name that is taken: then nothing is published."""
    assert main(["publish", "run", "-o", "run.zip", *options]) == 2
    assert said in capsys.readouterr().err
    assert not Path("run.zip").exists()


def test_doi_stands_beside_the_bundle(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is known after the digests are, so a replay tells it and no byte of the bundle changes."""
    Path("run.zip.doi").write_text("https://doi.org/10.5281/zenodo.1234567\n")
    assert doi_of(bundle) == "10.5281/zenodo.1234567"
    assert main(["replay", "run.zip"]) == 0
    assert "\ndoi: 10.5281/zenodo.1234567, as run.zip.doi says\n" in capsys.readouterr().out
    for written, told in ((b"\x1b[2J\xff no number", None), (b"10.1234/a\x1b[2Jb,\n", "10.1234/a\\x1b[2Jb")):
        Path("run.zip.doi").write_bytes(written)
        assert doi_of(bundle) == told
