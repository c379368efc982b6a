"""The same search runs on real tactile recordings, where they lie beside the checkout."""

import os
from pathlib import Path

import pytest
from checkout import SHARED
from smallest import ARCHIVES, DRAWN, UNTRACKED

from tacevo.cli.app import main

DATA = SHARED / "data"

needs_recordings = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not beside this checkout")

SMALL = [
    "experiment=published_force",
    *ARCHIVES,
    *DRAWN,
    UNTRACKED,
    "training.epochs=1",
    "search.generations=1",
    "search.candidates=2",
    "search.initial=1",
]


def searched(overrides: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Search, replay, and return the search's summary."""
    assert main(["search", *SMALL, *overrides]) == 0
    printed = capsys.readouterr().out
    (run,) = Path("runs").iterdir()
    assert main(["replay", str(run)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == printed.splitlines()[-1]
    return (run / "summary.md").read_text()


@pytest.mark.slow
@needs_recordings
def test_search_on_tactip_recordings(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Depth, roll and pitch from 3,000 TacTip images: the stand-in for three forces."""
    columns = "data.target_columns=[depth_mm,roll_deg,pitch_deg]"
    printed = searched(["data=csv", f"data.root={DATA / 'tactip_surface'}", columns], capsys)
    assert "2400 training, 300 validation and 300 test images" in printed


@pytest.mark.slow
@needs_recordings
def test_search_on_gelsight_recordings(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten materials from 1,000 GelSight images: the stand-in for gratings."""
    printed = searched(
        ["task=grating", "data=folder", f"data.root={DATA / 'gelsight_materials'}", "task.outputs=10"], capsys
    )
    assert "800 training, 100 validation and 100 test images" in printed


@needs_recordings
def test_wrong_number_of_classes_is_refused_with_the_remedy(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A task of seven classes does not silently train on ten."""
    arguments = ["task=grating", "data=folder", f"data.root={os.path.relpath(DATA / 'gelsight_materials')}"]
    assert main(["search", *SMALL, *arguments]) == 2
    assert "set task.outputs=10" in capsys.readouterr().err
