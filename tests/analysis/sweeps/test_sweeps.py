"""Promise: a sweep without anything to compare, or with a seed twice, is refused before a run is read.

What finished runs give, and what is said of missing ones, tests/cli/test_ablation_commands.py shows with real runs.
"""

from pathlib import Path

from ledger_lines import run_record
from refusals import refused

from tacevo.errors import RunError
from tacevo.results.sweep import load_sweep
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import Job, SweepDirectory, SweepRecord


def job(name: str, arm: str = "none", seed: int = 0) -> Job:
    """Make a job."""
    return Job(name=name, arm=arm, seed=seed, overrides=(f"ablation={arm}",), config=name)


def begin(folder: Path, *jobs: Job) -> SweepDirectory:
    """Write the sweep.json of these jobs."""
    directory = SweepDirectory(folder)
    directory.write(SweepRecord(overrides=(), jobs=jobs))
    return directory


def test_sweep_of_nothing_but_plans_is_refused(tmp_path: Path) -> None:
    """Neither a job that was never begun nor one that failed or was stopped is a result."""
    directory = begin(tmp_path, job("begun"), job("broken", seed=1), job("new", seed=2))
    (tmp_path / "begun").mkdir()
    RunDirectory(tmp_path / "begun").write_run(run_record())
    directory.fail(job("broken", seed=1), "no answer came")
    with refused(RunError, expected="at least one finished job", got="that are not finished"):
        load_sweep(tmp_path)


def test_seed_that_an_arm_has_twice_is_refused(tmp_path: Path) -> None:
    """It would count as two in every median; another arm may have it."""
    begin(tmp_path, job("one"), job("other", arm="a"), job("two"))
    with refused(RunError, place="sweep.json", got="2 jobs of arm none with seed 0"):
        load_sweep(tmp_path)


def test_damaged_description_of_a_run_is_no_missing_job(tmp_path: Path) -> None:
    """It is named, and not passed over."""
    begin(tmp_path, job("one"))
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "run.json").write_text("{")
    with refused(RunError, place="one/run.json"):
        load_sweep(tmp_path)
