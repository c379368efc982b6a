"""Promise: a name of nothing is answered before anything is read, with the jobs that were perhaps meant."""

import zipfile
from pathlib import Path

import pytest
from refusals import refused

from tacevo.errors import RunError
from tacevo.storage.places import check_place, check_sweep


@pytest.fixture
def places(tmp_path: Path) -> Path:
    """Return a directory with a sweep of two jobs, a bundle of three and one of a run, and a file of something else."""
    for name in ("sweep/sweep.json", "sweep/none-seed0/run.json", "sweep/none-seed1/run.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text("{}")
    members = {"sweep.zip": [f"sweep/{job}/run.json" for job in ("none-seed0", "drift-seed0", "drift-seed1")]}
    for bundle, names in {**members, "run.zip": ["run/run.json"]}.items():
        with zipfile.ZipFile(tmp_path / bundle, "w") as archive:
            for name in [*names, "sweep.json"]:
                archive.writestr(name, "{}")
    (tmp_path / "other.zip").write_bytes(b"PK\x03\x04" + b"none" * 9)
    return tmp_path


@pytest.mark.parametrize("name", ["sweep", "sweep/none-seed0", "sweep.zip", "sweep.zip/drift-seed1", "other.zip/job"])
def test_what_may_be_there_is_left_to_its_reader(name: str, places: Path) -> None:
    """A damaged bundle, too: its reader says what is wrong with it."""
    check_place(places / name)


@pytest.mark.parametrize(
    ("name", "expected", "got"),
    [
        ("nowhere", "the directory or bundle of a run or a sweep", "a path that does not exist"),
        ("sweep/none-seed9", "one of its 2 jobs, such as none-seed", "'none-seed9'"),
        ("sweep.zip/drift-sed1", "one of its 3 jobs, such as drift-seed1, drift-seed0", "'drift-sed1'"),
        ("sweep.zip/..", "one of its 3 jobs, such as none-seed0", "'..'"),
        ("run.zip/job", "the bundle of a sweep", "one run"),
    ],
)
def test_name_of_nothing_is_refused(name: str, expected: str, got: str, places: Path) -> None:
    """With the nearest jobs, where there are jobs."""
    with refused(RunError, expected=expected, got=got):
        check_place(places / name)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("demo", "runs/demo"),
        ("runs/dmeo", "runs/demo"),
        ("runs/mine", "sweeps/mine"),
        ("claude.zip", "cache/published/claude.zip"),
        ("claude", "cache/published/claude.zip"),
        ("claud.zip", "cache/published/claude.zip"),
        ("elsewhere/demo", "runs/demo"),
    ],
)
def test_name_without_its_directory_or_with_a_slip_is_asked_for(
    typed: str, meant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where runs, sweeps and published bundles usually lie, and beside what was typed."""
    for name in ("runs/demo/run.json", "sweeps/mine/sweep.json", "cache/published/claude.zip"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    monkeypatch.chdir(tmp_path)
    with refused(RunError, place=typed, remedy=f"did you mean {meant}?"):
        check_place(Path(typed))


def test_directory_of_runs_is_no_run(places: Path) -> None:
    """It names what it holds, and how to name one; an empty one is left to its reader."""
    with refused(RunError, place=str(places), got="holds other.zip, run.zip, sweep, ..."):
        check_place(places)
    (places / "empty").mkdir()
    check_place(places / "empty")


def test_run_is_no_sweep(places: Path) -> None:
    """It has no arms, finished or not."""
    check_sweep(places / "sweep")
    with refused(RunError, expected="the directory or bundle of a sweep", got="that of a run", remedy="has no arms"):
        check_sweep(places / "sweep" / "none-seed0")
