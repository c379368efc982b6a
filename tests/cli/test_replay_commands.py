"""Promise: the directory of a run is compared with its records as a bundle is; what is not finished is passed over."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tacevo.cli.app import main
from tacevo.sandbox.client import Sandbox


@pytest.fixture
def without_sandbox(published: Path, swept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no sandbox be made; what is replayed has been recorded before."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a replay made a sandbox")

    monkeypatch.setattr(Sandbox, "__init__", refuse)


def test_edited_summary_in_a_folder_is_found(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It follows from the records; where another version wrote it, that is said, too."""
    (run / "summary.md").write_text((run / "summary.md").read_text().replace("Lowest fitness 0", "Lowest fitness -0"))
    described = json.loads((run / "run.json").read_text())
    described["versions"]["tacevo"] = "0.0.1"
    (run / "run.json").write_text(json.dumps(described))
    assert main(["replay", str(run)]) == 1
    words = "the command that began the run writes it again; another version may be the reason"
    assert words in capsys.readouterr().err


def test_unfinished_study_in_a_folder_is_passed_over(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It makes no run another one."""
    (study,) = (run / "studies").iterdir()
    described = json.loads((study / "study.json").read_text())
    (study / "study.json").write_text(json.dumps({**described, "digest": None}))
    (study / "scores.jsonl").unlink()
    assert main(["replay", str(run)]) == 0
    assert f"study {study.name} is not finished and is passed over" in capsys.readouterr().err


@pytest.mark.usefixtures("without_sandbox")
@pytest.mark.parametrize(
    ("recorded", "told"), [("run", "study "), ("run.zip", "study "), ("sweep", "job "), ("sweep.zip", "job ")]
)
def test_replay_needs_no_sandbox(
    recorded: str,
    told: str,
    published: Path,
    swept: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A run with its study and a sweep are replayed where no sandbox can be made."""
    place = swept if recorded.startswith("sweep") else published
    assert main(["replay", str(place / recorded)]) == 0
    assert f"\n{told}" in capsys.readouterr().out


@pytest.mark.slow
def test_what_reads_records_imports_nothing_that_composes_draws_or_trains(published: Path) -> None:
    """A recorded configuration is whole, so a replay does without Hydra, which takes half a second, as tables do."""
    script = (
        "import sys, tacevo.cli.publish, tacevo.cli.tables\nfrom tacevo.cli.app import main\n"
        f"status = main(['replay', {str(published / 'run.zip')!r}])\n"
        "print('slow:', status, sorted({'hydra', 'matplotlib', 'mlflow', 'omegaconf', 'torch'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert "slow: 0 []" in out
