"""Promise: a published sweep is compared as its directory is, with the stores and the output that the user names."""

import shutil
from pathlib import Path

import pytest
from run_files import contents

from tacevo.cli.app import main


@pytest.mark.slow
def test_bundle_and_folder_give_the_same_files(swept: Path, tmp_path: Path) -> None:
    """Tables and figures, byte by byte, whatever the directory of the sweep is called."""
    assert main(["ablations", str(swept / "sweep"), "-o", str(tmp_path / "folder")]) == 0
    (tmp_path / "renamed").symlink_to(swept / "sweep")
    assert main(["ablations", str(tmp_path / "renamed"), "-o", str(tmp_path / "renamed out")]) == 0
    assert main(["ablations", str(swept / "sweep.zip"), "-o", str(tmp_path / "file")]) == 0
    files = contents(tmp_path / "folder")
    assert "ablation.md" in files
    assert contents(tmp_path / "file") == files == contents(tmp_path / "renamed out")


def test_place_for_a_bundle_is_asked_for(swept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing is written into a file, or beside it unasked."""
    assert main(["ablations", str(swept / "sweep.zip")]) == 2
    told = capsys.readouterr().err
    assert "sweep.zip; name by -o where to write ablations" in told


@pytest.mark.room("figures")
def test_named_store_is_that_of_a_bundle_too(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is read instead of the bundle's own, which is sound: damage in the named one is told."""
    shutil.copytree(swept / "cache" / "centroids", tmp_path / "named" / "centroids")
    for entry in (tmp_path / "named").rglob("*.json"):
        entry.write_text("{")
    command = ["ablations", str(swept / "sweep.zip"), "-o", str(tmp_path / "out"), "--store", str(tmp_path / "named")]
    assert main(command) == 2
    assert str(tmp_path / "named" / "centroids") in capsys.readouterr().err
