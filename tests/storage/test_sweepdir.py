"""A sweep's folder gives back what was written, and refuses what no sweep writes."""

import json
from pathlib import Path

import pytest

from tacevo.errors import RunError
from tacevo.storage.sweep_directory import Job, SweepDirectory

JOBS = (
    Job(name="none-seed0", arm="none", seed=0, overrides=("ablation=none", "seed=0"), config="a" * 64),
    Job(name="none-seed1", arm="none", seed=1, overrides=("ablation=none", "seed=1"), config="b" * 64),
)


def test_jobs_are_read_as_they_were_written(tmp_path: Path) -> None:
    """What one process writes, another reads."""
    SweepDirectory(tmp_path / "sweep").write(["experiment=demo"], JOBS)

    assert SweepDirectory(tmp_path / "sweep").read() == (("experiment=demo",), JOBS)
    assert SweepDirectory(tmp_path / "sweep").run(JOBS[0]).path == tmp_path / "sweep" / "none-seed0"


def test_a_folder_without_a_sweep_is_named(tmp_path: Path) -> None:
    """A run's folder, say, is no sweep's."""
    with pytest.raises(RunError, match=r"it has no sweep\.json"):
        SweepDirectory(tmp_path).read()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 1}', '{"schema": 1, "overrides": [], "jobs": [1]}'])
def test_damage_is_named(tmp_path: Path, text: str) -> None:
    """Nothing of a damaged file is believed."""
    (tmp_path / "sweep.json").write_text(text)

    with pytest.raises(RunError, match="is damaged"):
        SweepDirectory(tmp_path).read()


def test_another_layout_is_named(tmp_path: Path) -> None:
    """A later version's file is refused, not half read."""
    (tmp_path / "sweep.json").write_text('{"schema": 99}')

    with pytest.raises(RunError, match="this version reads 1"):
        SweepDirectory(tmp_path).read()


@pytest.mark.parametrize("name", ["../none", "/none", "", "..", "failed", "launch", 3])
def test_a_job_lies_in_its_sweep(tmp_path: Path, name: object) -> None:
    """An edited sweep.json cannot lead elsewhere."""
    directory = SweepDirectory(tmp_path)
    directory.write([], JOBS)
    value = json.loads((tmp_path / "sweep.json").read_text())
    value["jobs"][0]["name"] = name
    (tmp_path / "sweep.json").write_text(json.dumps(value))

    with pytest.raises(RunError, match="must be that of a folder"):
        directory.read()


def test_a_failure_is_kept_until_the_job_succeeds(tmp_path: Path) -> None:
    """The reason stands there for whoever looks, and goes when the job is through."""
    directory = SweepDirectory(tmp_path)

    assert directory.failure(JOBS[0]) is None
    directory.fail(JOBS[0], "the disk is full")
    assert directory.failure(JOBS[0]) == "the disk is full"
    assert directory.failure(JOBS[1]) is None
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
def test_a_field_of_another_type_is_named(tmp_path: Path, field: str, value: object) -> None:
    """Nothing is read as what it nearly is, and nothing is passed over."""
    directory = SweepDirectory(tmp_path)
    directory.write([], JOBS)
    told = json.loads((tmp_path / "sweep.json").read_text())
    told["jobs"][0][field] = value
    (tmp_path / "sweep.json").write_text(json.dumps(told))

    with pytest.raises(RunError, match=rf"sweep\.json is damaged: .*{field}.*(must be|no job has)"):
        directory.read()


def test_shared_overrides_are_texts(tmp_path: Path) -> None:
    """A number is none."""
    (tmp_path / "sweep.json").write_text('{"schema": 1, "overrides": [1], "jobs": []}')

    with pytest.raises(RunError, match="'overrides' must be a list of texts"):
        SweepDirectory(tmp_path).read()
