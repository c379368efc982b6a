"""Promise: a sweep.json that says of a job what its run does not is found out, and the job is named."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tacevo.errors import DivergenceError
from tacevo.job_checks import check_jobs
from tacevo.records import Json
from tacevo.replaying import read_run
from tacevo.rundir import RunDirectory
from tacevo.sweepdir import SweepDirectory, name_arm
from tacevo.sweepstatus import config_hash

Edit = Callable[[Json], object]


@pytest.fixture
def sweep(swept: Path, tmp_path: Path) -> Path:
    """Give the folder of a sweep of one's own."""
    shutil.copytree(swept / "sweep", tmp_path / "sweep")
    return tmp_path / "sweep"


def edit(sweep: Path, change: Edit) -> None:
    """Change sweep.json."""
    value = json.loads((sweep / "sweep.json").read_text())
    change(value)
    (sweep / "sweep.json").write_text(json.dumps(value))


def refused(sweep: Path, words: str) -> None:
    """See that the sweep is found to be edited."""
    with pytest.raises(DivergenceError, match=re.escape(words)):
        check_jobs(SweepDirectory(sweep))


def test_sound_sweep_passes(sweep: Path) -> None:
    """As it was written."""
    check_jobs(SweepDirectory(sweep))


@pytest.mark.parametrize(
    ("field", "value"),
    [("seed", 7), ("arm", "fixed_temperature"), ("config", "0" * 64)],
)
def test_edited_field_is_named(field: str, value: Json, sweep: Path) -> None:
    """With its job, and both values."""
    edit(sweep, lambda told: told["jobs"][1].update({field: value}))
    refused(sweep, f"job none-seed1: field {field!r} is {value!r}, and by its run and overrides ")


def test_arm_renamed_with_its_overrides_is_found(sweep: Path) -> None:
    """The settings that the new name stands for are not those of the run."""
    edit(
        sweep,
        lambda told: told["jobs"][1].update(
            arm="fixed_temperature", overrides=["ablation=fixed_temperature", "seed=1"]
        ),
    )
    refused(sweep, "its overrides give config.temperature.")


def test_two_arms_that_changed_names_are_found(sweep: Path) -> None:
    """Also where every job of both was renamed, so that each arm is still one arm."""

    def swap(told: Json) -> None:
        for job in told["jobs"]:
            job["arm"] = {"none": "fixed_temperature", "fixed_temperature": "none"}[job["arm"]]
            job["overrides"][0] = f"ablation={job['arm']}"

    edit(sweep, swap)
    refused(sweep, "its overrides give config.temperature.")


def test_seed_changed_with_its_overrides_is_found(sweep: Path) -> None:
    """The run's configuration has its own."""
    edit(sweep, lambda told: told["jobs"][0].update(seed=5, overrides=["ablation=none", "seed=5"]))
    refused(sweep, "field 'seed' is 5, and by its run and overrides 0")


def test_runs_that_changed_places_are_found(sweep: Path) -> None:
    """Each job's run is that of the other."""
    names = ("none-seed0", "fixed_temperature-seed0")
    (sweep / names[0]).rename(sweep / "aside")
    (sweep / names[1]).rename(sweep / names[0])
    (sweep / "aside").rename(sweep / names[1])
    refused(sweep, "job none-seed0: field 'config' is ")


def test_runs_and_hashes_that_changed_places_are_found(sweep: Path) -> None:
    """A hash made anew does not make another run this job's."""
    names = ("none-seed0", "fixed_temperature-seed0")
    (sweep / names[0]).rename(sweep / "aside")
    (sweep / names[1]).rename(sweep / names[0])
    (sweep / "aside").rename(sweep / names[1])
    runs = {name: config_hash(read_run(RunDirectory(sweep / name))[0]) for name in names}

    def reseal(told: Json) -> None:
        for job in told["jobs"]:
            job["config"] = runs.get(job["name"], job["config"])

    edit(sweep, reseal)
    refused(sweep, "its overrides give config.temperature.")


def test_shared_setting_that_no_run_has_is_found(sweep: Path) -> None:
    """What sweep.json says of all jobs is held against each."""
    edit(sweep, lambda told: told.update(overrides=[*told["overrides"], "search.candidates=9"]))
    refused(sweep, "job none-seed0: its overrides give config.search.candidates=9, and its run has 2")


def test_job_that_is_there_twice_is_found(sweep: Path) -> None:
    """One run under two names is no second seed."""
    shutil.copytree(sweep / "none-seed0", sweep / "again")
    edit(sweep, lambda told: told["jobs"].append({**told["jobs"][0], "name": "again"}))
    refused(sweep, "jobs none-seed0 and again have one configuration")


def test_overrides_that_compose_nothing_are_found(sweep: Path) -> None:
    """A traceback is no answer."""
    edit(sweep, lambda told: told.update(overrides=["experiment=mine"]))
    refused(sweep, "the overrides of job none-seed0 give no configuration here: ")


@pytest.mark.parametrize(
    ("overrides", "arm"),
    [
        (["ablation=none", "seed=3"], "none"),
        (["seed=3", "temperature=fixed"], "temperature=fixed"),
        (["ablation=none", "training.epochs=2", "seed=0"], "none training.epochs=2"),
        (["seed=0"], "none"),
    ],
)
def test_arm_is_what_is_varied_but_the_seed(overrides: list[str], arm: str) -> None:
    """An ablation by its name alone."""
    assert name_arm(overrides) == arm
