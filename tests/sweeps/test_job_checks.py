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


def renamed(arm: str, to: str) -> Edit:
    """Give the jobs of an arm another name of it."""
    return lambda told: [job.update(arm=to) for job in told["jobs"] if job["arm"] == arm]


def test_what_runs_recorded_is_what_counts(sweep: Path) -> None:
    """A sweep passes as it was written, and where defaults changed: overrides are not composed again."""
    check_jobs(SweepDirectory(sweep))
    edit(sweep, lambda told: told.update(overrides=["experiment=of_an_earlier_release"]))
    check_jobs(SweepDirectory(sweep))


@pytest.mark.parametrize(
    ("changes", "fields"),
    [
        ([lambda told: told["jobs"][1].update(seed=7)], ("job none-seed1, seed", "as in its run", "7")),
        ([lambda told: told["jobs"][1].update(config="0" * 64)], ("none-seed1, config", "as in its run", "0" * 64)),
        (
            [lambda told: told["jobs"][0].update(seed=5, overrides=["ablation=none", "seed=5"])],
            ("seed", "0, as in its run", "5"),
        ),
        (
            [renamed("fixed_temperature", "none")],
            ("job fixed_temperature-seed0", "the settings of arm 'none', except", "values of config.temperature."),
        ),
        (
            [lambda told: told["jobs"].pop(), lambda told: told["jobs"][1].update(arm="mine")],
            ("arms 'none' and 'mine'", "", "the same"),
        ),
        (  # whoever states afterwards that jobs have data of their own is contradicted by the runs
            [lambda told: told.setdefault("terms", {}).update(vary=["data.split_seed"])],
            ("terms.vary, job none-seed1", "settings that are 1 in its run", "data.split_seed"),
        ),
    ],
)
def test_edited_sweep_is_found(changes: list[Edit], fields: tuple[str, str, str], sweep: Path) -> None:
    """With the job and both values; runs of two arms under one name, and one arm under two names, too."""
    for change in changes:
        edit(sweep, change)
    place, expected, got = fields
    with refused(DivergenceError, place=place, expected=expected, got=got):
        check_jobs(SweepDirectory(sweep))


def test_run_under_another_name_is_found(sweep: Path) -> None:
    """One run under two names is not a second seed, nor is a job's run that of another."""
    shutil.copytree(sweep / "none-seed0", sweep / "again")
    edit(sweep, lambda told: told["jobs"].append({**told["jobs"][0], "name": "again"}))
    with refused(DivergenceError, place="jobs none-seed0 and again", got="the same"):
        check_jobs(SweepDirectory(sweep))
    shutil.rmtree(sweep / "none-seed0")
    (sweep / "fixed_temperature-seed0").rename(sweep / "none-seed0")
    with refused(DivergenceError, place="job none-seed0, config", expected="as in its run"):
        check_jobs(SweepDirectory(sweep))
