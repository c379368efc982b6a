"""Promise: the folder of a run is held against its records as a bundle is, and what is not finished is passed over."""

import json
import shutil
from pathlib import Path

import pytest

from tacevo.app import main


@pytest.fixture
def run(published: Path, tmp_path: Path) -> Path:
    """Give the folder of a run of one's own, with a study."""
    shutil.copytree(published / "run", tmp_path / "run")
    return tmp_path / "run"


def refused(run: Path, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    """See that a replay of the folder finds a difference."""
    assert main(["replay", str(run)]) == 1
    assert words in capsys.readouterr().err


def test_edited_cost_in_a_folder_is_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The recorded answers say what they cost."""
    first, *rest = (run / "timings.jsonl").read_text().splitlines()
    edited = json.dumps({**json.loads(first), "output_tokens": 12345})
    (run / "timings.jsonl").write_text("\n".join([edited, *rest]) + "\n")
    refused(run, "timings.jsonl: g00s00 was recorded with", capsys)


def test_edited_summary_in_a_folder_is_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It follows from the records; where another version wrote it, that is said, too."""
    (run / "summary.md").write_text((run / "summary.md").read_text().replace("Best fitness 0", "Best fitness -0"))
    described = json.loads((run / "run.json").read_text())
    described["versions"]["tacevo"] = "0.0.1"
    (run / "run.json").write_text(json.dumps(described))
    refused(run, "the command that began the run writes it anew; this may come of another version", capsys)


def test_renamed_study_in_a_folder_is_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its tables would bear the name."""
    (study,) = (run / "studies").iterdir()
    study.rename(study.with_name("forty_seeds"))
    refused(run, f"must be {study.name}, which is what it is", capsys)


def test_unfinished_study_in_a_folder_is_passed_over(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It makes no run another one."""
    (study,) = (run / "studies").iterdir()
    described = json.loads((study / "study.json").read_text())
    (study / "study.json").write_text(json.dumps({**described, "digest": None}))
    (study / "scores.jsonl").unlink()
    assert main(["replay", str(run)]) == 0
    assert f"study {study.name} is not finished and is passed over" in capsys.readouterr().err
