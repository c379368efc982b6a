"""Promise: a sweep.json that differs from what the runs of its jobs recorded is an error that names the job."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

from tacevo.errors import DivergenceError
from tacevo.results.sweep_jobs import check_jobs
from tacevo.storage.sweep_directory import SweepDirectory

Edit = Callable[[Any], object]


def edit(sweep: Path, change: Edit) -> None:
    """Change sweep.json."""
    value = json.loads((sweep / "sweep.json").read_text())
    change(value)
    (sweep / "sweep.json").write_text(json.dumps(value))


def rejected(sweep: Path, **fields: str) -> None:
    """Expect an error with these fields."""
    with refused(DivergenceError, **fields):
        check_jobs(SweepDirectory(sweep))


def test_sound_sweep_passes(sweep: Path) -> None:
    """As it was written."""
    check_jobs(SweepDirectory(sweep))


@pytest.mark.parametrize(
    ("field", "value"),
    [("seed", 7), ("config", "0" * 64)],
)
def test_edited_field_is_named(field: str, value: Any, sweep: Path) -> None:
    """With its job, and both values."""
    edit(sweep, lambda told: told["jobs"][1].update({field: value}))
    rejected(sweep, place=f"job none-seed1, {field}", expected="as in its run", got=repr(value))


def test_seed_changed_with_its_overrides_is_found(sweep: Path) -> None:
    """The run's configuration has its own."""
    edit(sweep, lambda told: told["jobs"][0].update(seed=5, overrides=["ablation=none", "seed=5"]))
    rejected(sweep, place="seed", expected="0, as in its run", got="5")


def test_runs_that_changed_places_are_found(sweep: Path) -> None:
    """Each job's run is that of the other."""
    names = ("none-seed0", "fixed_temperature-seed0")
    (sweep / names[0]).rename(sweep / "aside")
    (sweep / names[1]).rename(sweep / names[0])
    (sweep / "aside").rename(sweep / names[1])
    rejected(sweep, place="job none-seed0, config", expected="as in its run")


def test_job_that_is_there_twice_is_found(sweep: Path) -> None:
    """One run under two names is not a second seed."""
    shutil.copytree(sweep / "none-seed0", sweep / "again")
    edit(sweep, lambda told: told["jobs"].append({**told["jobs"][0], "name": "again"}))
    rejected(sweep, place="jobs none-seed0 and again", got="the same")


def rename_arm(sweep: Path, *, arm: str, to: str) -> None:
    """Give an arm another name."""

    def change(told: Any) -> None:
        for job in told["jobs"]:
            if job["arm"] == arm:
                job["arm"] = to

    edit(sweep, change)


def test_arm_has_settings_of_its_own(sweep: Path) -> None:
    """Runs of two arms under one name, and one arm under two names, are found."""
    rename_arm(sweep, arm="fixed_temperature", to="none")
    rejected(
        sweep,
        place="job fixed_temperature-seed0",
        expected="the settings of arm 'none', except for the seed",
        got="other values of config.temperature.",
    )
    edit(sweep, lambda told: told["jobs"][1].update(arm="mine"))
    edit(sweep, lambda told: told["jobs"].pop())
    rejected(sweep, place="arms 'none' and 'mine'", got="the same")


def test_default_that_changed_makes_no_sweep_another_one(sweep: Path) -> None:
    """What counts is what the runs recorded: overrides are not composed again under the defaults of the day."""
    edit(sweep, lambda told: told.update(overrides=["experiment=of_an_earlier_release"]))
    check_jobs(SweepDirectory(sweep))


def test_setting_that_no_run_took_from_its_seed_is_found(sweep: Path) -> None:
    """Whoever states afterwards that jobs have data of their own is contradicted by the runs."""
    edit(sweep, lambda told: told.setdefault("terms", {}).update(vary=["data.split_seed"]))
    rejected(
        sweep, place="terms.vary, job none-seed1", expected="settings that are 1 in its run", got="data.split_seed"
    )
