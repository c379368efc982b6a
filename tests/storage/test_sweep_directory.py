"""A sweep's directory returns what was written, and rejects what no sweep writes."""

import json
from pathlib import Path

import pytest
from refusals import refused

from tacevo.errors import RunError
from tacevo.storage.sweep_directory import Failure, Job, SweepDirectory, SweepRecord

JOBS = (
    Job(name="none-seed0", arm="none", seed=0, overrides=("ablation=none", "seed=0"), config="a" * 64),
    Job(name="none-seed1", arm="none", seed=1, overrides=("ablation=none", "seed=1"), config="b" * 64),
)


def test_jobs_are_read_as_they_were_written(tmp_path: Path) -> None:
    """What one process writes, another reads."""
    sweep = SweepRecord(overrides=("experiment=demo",), jobs=JOBS)
    SweepDirectory(tmp_path / "sweep").write(sweep)

    assert SweepDirectory(tmp_path / "sweep").read() == sweep
    assert SweepDirectory(tmp_path / "sweep").run(JOBS[0]).path == tmp_path / "sweep" / "none-seed0"


def test_directory_without_a_sweep_is_named(tmp_path: Path) -> None:
    """A run's directory, say, is not a sweep's."""
    with refused(RunError, place=str(tmp_path), expected="the directory of a sweep"):
        SweepDirectory(tmp_path).read()


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", ""),
        ("[]", ""),
        ('{"schema": 1}', ", overrides"),
        ('{"schema": 99, "overrides": [], "jobs": []}', ", schema"),
        ('{"schema": 1, "overrides": [], "jobs": [1]}', ", jobs.0"),
        ('{"schema": 1, "overrides": [1], "jobs": []}', ", overrides.0"),
    ],
)
def test_damage_is_named(tmp_path: Path, text: str, place: str) -> None:
    """Nothing of a damaged file, or one of a later version, is believed."""
    (tmp_path / "sweep.json").write_text(text)
    with refused(RunError, place=f"sweep.json{place}", remedy="restore it, or delete it"):
        SweepDirectory(tmp_path).read()


def test_failure_is_kept_until_the_job_succeeds(tmp_path: Path) -> None:
    """An early sweep does not say whose the failure was; one whose words cannot be read is a failure all the same."""
    directory = SweepDirectory(tmp_path)
    file = tmp_path / "failed" / "none-seed0.json"
    assert directory.failure(JOBS[0]) is None
    directory.fail(JOBS[0], "the node is gone", by_scheduler=True)
    assert directory.failure(JOBS[0]) == Failure(job="none-seed0", reason="the node is gone", by_scheduler=True)
    assert directory.failure(JOBS[1]) is None
    file.write_text('{"job": "none-seed0", "reason": "the disk is full"}')
    assert directory.failure(JOBS[0]) == Failure(job="none-seed0", reason="the disk is full", by_scheduler=False)
    file.write_text("{")
    assert "none-seed0.json: expected JSON" in str(directory.failure(JOBS[0]))
    directory.succeed(JOBS[0])
    assert directory.failure(JOBS[0]) is None


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("seed", 0.9),
        ("seed", "0"),
        ("seed", False),
        ("arm", None),
        ("config", 1),
        ("overrides", "seed=0"),
        ("overrides", [0]),
        ("note", "mine"),
    ],
)
def test_field_of_another_type_is_named(tmp_path: Path, field: str, value: object) -> None:
    """Nothing is read as what it nearly is, and nothing is passed over."""
    with refused(RunError, place=f"sweep.json, jobs.0.{field}"):
        edited(tmp_path, field, value).read()


@pytest.mark.parametrize("name", ["../none", "/none", "", "..", "failed", "launch", 3])
def test_job_lies_in_its_sweep(tmp_path: Path, name: object) -> None:
    """An edited sweep.json cannot lead elsewhere."""
    with refused(RunError, place="sweep.json, jobs", got=json.dumps(name).strip('"')):
        edited(tmp_path, "name", name).read()


def edited(folder: Path, field: str, value: object) -> SweepDirectory:
    """Write a sweep.json whose first job has this value."""
    directory = SweepDirectory(folder)
    directory.write(SweepRecord(overrides=(), jobs=JOBS))
    whole = json.loads((folder / "sweep.json").read_text())
    whole["jobs"][0][field] = value
    (folder / "sweep.json").write_text(json.dumps(whole))
    return directory
