"""A recording whose table names its sensors is studied as the release's: within, across and with one left out."""

from pathlib import Path

import pytest
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

from tacevo.api.opening import open_run
from tacevo.cli.app import main
from tacevo.results.study_directory import studies_of

pytestmark = pytest.mark.room("simulator", "data check")

SETTINGS = ["task=force", "data=csv", "data.root=images", "data.target_columns=[Fx,Fy,Fz]", "data.image_size=32"]


@pytest.fixture
def recorded(place: Path) -> Path:
    """Work beside images of two sensors, whose table names them and the parts."""
    assert main(["data", "simulate", "task=force", "n=60", "data.image_size=32", "out=images"]) == 0
    labels = place / "images" / "labels.csv"
    header, *rows = labels.read_text().splitlines()
    parts = ("train", "train", "train", "val", "test")
    named = [f"{row},{'AB'[number % 2]},{parts[number // 2 % 5]}" for number, row in enumerate(rows)]
    labels.write_text("\n".join([f"{header},gel,part", *named, ""]))
    return place


def test_check_takes_what_is_asked_for(recorded: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """All sensors, where the command names none; and what was selected is told."""
    usual = ["data", "check", *SETTINGS, "data.sensor_column=gel"]
    assert main([*usual, "data.split_column=part"]) == 0
    assert "60: 36 training, 12 validation, 12 test" in capfd.readouterr().out
    assert main([*usual, "data.split_column=part", "data.test_sensor=B"]) == 0
    told = capfd.readouterr().out
    assert "30: 18 training, 6 validation, 6 test" in told
    assert "data.test_sensor=B" in told
    assert main([*usual, "data.sensor=C"]) == 2
    assert main(["data", "check", *SETTINGS, "data.sensor=A"]) == 2


def test_sensor_that_is_not_there_is_told_before_a_study_is_trained(
    recorded: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Wherever it stands among the values; nothing is written."""
    size = [word for word in SMALLEST if not word.startswith("data.")]
    own = [*SETTINGS, "data.sensor_column=gel", "data.sensor=A", "run.dir=run"]
    assert main(["search", *size, UNTRACKED, "search.generations=0", *own]) == 0
    for asked in (["data.sensor=B,D"], ["data.sensor=A", "data.test_sensor=B,D"]):
        assert main(["study", "run", "elites=1", "seeds=1", "epochs=1", *asked]) == 2
        assert "got D" in capfd.readouterr().err
    assert not [*studies_of(Path("run"))]


@pytest.mark.slow
def test_protocols_of_the_release_with_a_table(recorded: Path) -> None:
    """Each is a study of its own, and all replay; those that test one sensor test the same images."""
    size = [word for word in SMALLEST if not word.startswith("data.")]
    own = [*SETTINGS, "data.sensor_column=gel", "data.split_column=part", "data.sensor=A", "run.dir=run"]
    assert main(["search", *size, UNTRACKED, *PUBLISHED_SIZES, *own]) == 0
    usual = ["study", "run", "elites=1", "seeds=2", "epochs=1"]
    assert main([*usual, "data.sensor=A,B"]) == 0
    assert main([*usual, "data.sensor=*", "data.test_sensor=A,B"]) == 0
    assert main([*usual, "data.sensor=A", "data.test_sensor=B", "data.shots=1,2"]) == 0
    recorded_data = [study.read().data for study in studies_of(Path("run"))]
    assert sorted(one.counts for one in recorded_data) == [(18, 6, 6)] * 4 + [(19, 6, 6), (20, 6, 6)]
    assert len({one.fingerprint for one in recorded_data}) == 6
    run = open_run("run")
    assert run.replay(quiet=True) == run.digest
