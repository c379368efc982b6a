"""Promise: a sweep's jobs are all known before one runs, each has its directory, and none is run twice."""

import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from checkout import ROOT
from refusals import refused
from sweeps import SHARED, Heard, Launched, begin, composed, files_of

from tacevo.config.schema import RunConfig
from tacevo.errors import ConfigError, RunError
from tacevo.results.sweep import Standing
from tacevo.storage.sweep_directory import Job, SweepDirectory, name_arm
from tacevo.sweeps import search_process
from tacevo.sweeps.launch import Launcher
from tacevo.sweeps.prospects import shortcomings
from tacevo.sweeps.sweeping import folder, name_job, part, plan, sweep

TWO_BY_TWO = [*SHARED, "ablation=none,fixed_temperature", "seed=0,1"]
NAMES = ["none-seed0", "none-seed1", "fixed_temperature-seed0", "fixed_temperature-seed1"]


def test_several_values_tell_jobs_apart() -> None:
    """What has one value is shared, but for the ablation and the seed, to which others may come."""
    shared, varied = part(["experiment=demo", "ablation=none", "seed=range(0,2)", "temperature=paper,stall"], ())

    assert shared == ("experiment=demo",)
    assert varied == (
        ("ablation=none", "seed=0", "temperature=paper"),
        ("ablation=none", "seed=0", "temperature=stall"),
        ("ablation=none", "seed=1", "temperature=paper"),
        ("ablation=none", "seed=1", "temperature=stall"),
    )


def test_search_that_does_not_end_when_told_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its job has failed by a signal, which the sweep says."""
    monkeypatch.setattr(search_process, "GRACE", 0.1)
    deaf = "import signal, sys, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as search:
        assert search.stdout is not None
        search.stdout.readline()
        search_process.stop([search])
        assert search.returncode == -signal.SIGKILL
    (tmp_path / "log").write_text("error: what was said before\n")
    reason = search_process._reason(search.returncode, tmp_path / "log")
    assert reason == "killed by signal 9 (Killed); memory may have run out"


@pytest.mark.parametrize(
    ("setting", "place"),
    [
        ("run.dir=runs/mine", "run.dir"),
        ("tracking.uri='postgresql://me:hunter2@host/db'", "tracking.uri"),
        ("llm.base_url=https://hunter2@host/v1,https://host/v1", "llm.base_url"),
        ("search.generations=interval(1,5)", ""),
        ("seed=range(3,3)", ""),
        ("seed=1,", ""),
        ("hydra.sweep.dir=mine", ""),
        ("+seed=1,2", ""),
    ],
)
def test_override_that_a_sweep_cannot_have_is_rejected(setting: str, place: str) -> None:
    """Values without an end, and what sweep.json must not keep; a password is not shown."""
    with pytest.raises(ConfigError) as raised:
        part([*SHARED, setting], ())
    assert raised.value.place.startswith(place)
    assert "hunter2" not in str(raised.value)


@pytest.mark.parametrize(
    ("own", "arm", "name"),
    [
        (("ablation=no_qd", "seed=3"), "no_qd", "no_qd-seed3"),
        (("seed=3",), "none", "none-seed3"),
        (("temperature=stall", "seed=3"), "temperature=stall", "temperature-stall-seed3"),
        (("ablation=none", "proposals.best=2"), "none proposals.best=2", "none-proposals.best-2-seed3"),
        (
            (r"prompts.policy=mine.py\:Mine",),
            "prompts.policy=mine.py:Mine",
            name_job((r"prompts.policy=mine.py\:Mine",), 3),
        ),
    ],
)
def test_arm_is_what_is_compared(own: tuple[str, ...], arm: str, name: str) -> None:
    """The ablation, and whatever else is varied but the seed, in a form that a directory can be called."""
    assert name_arm(own) == arm
    assert name_job(own, 3) == name


@pytest.mark.parametrize(
    "arms",
    [
        ["task.system=../a", "task.system=../b", "task.system=..-a"],
        [f"ablation={'x' * length}" for length in (500, 501)],
        ["data.root=/home/ada/force", "data.root=/home/bob/force"],  # names are published: the last part of a path
    ],
)
def test_names_lead_nowhere_and_tell_arms_apart(arms: list[str]) -> None:
    """Characters that no directory should have, and folders of this machine, are left out."""
    names = {name_job([arm], 0) for arm in arms}
    assert len(names) == len(arms)
    assert all("/" not in name and len(name) < 120 for name in names)
    assert not {"home", "ada", "bob"} & {part for name in names for part in name.split("-")}


@pytest.mark.slow
def test_all_arms_of_the_default_search_are_listed_as_the_manual_says() -> None:
    """A list of all but the one that needs an LLM can be composed."""
    shared, varied = part([*SHARED, "ablation=glob(*,exclude=llm_vs_grammar)"], ())

    assert len(plan(shared, varied)) == len(varied) > 10
    assert "'ablation=glob(*,exclude=llm_vs_grammar)'" in ROOT.joinpath("docs/sweeps.md").read_text()


def test_mistake_in_any_job_is_raised_before_one_runs(place: Path) -> None:
    """The last of many jobs cannot be composed: the job and the fault are named, and nothing is begun."""
    launched = Launched()
    with refused(ConfigError, place="ablation=none seed=-1"):
        sweep([*SHARED, "ablation=none", "seed=0,1,-1"], None, Heard(), launched)
    assert not launched.calls
    assert not list(place.iterdir())


@pytest.mark.parametrize("override", ["hydra/launcher=nowhere", "hydra.launcher.njobs=2"])
def test_launcher_that_cannot_be_used_is_an_error_before_a_job_runs(override: str, place: Path) -> None:
    """A misspelt launcher, or option of one, leaves no directory behind."""
    with refused(ConfigError, place="launcher"):
        sweep([*TWO_BY_TWO, override], None, Heard(), Launched())
    assert not list(place.iterdir())


def test_job_that_let_go_of_its_directory_late_has_failed(place: Path) -> None:
    """As where a search is killed with what started it, and is still there for a moment: what is told last is true."""

    def run(
        directory: SweepDirectory, jobs: Mapping[Job, RunConfig], launcher: Launcher, show: Callable[[Job], None]
    ) -> None:
        (job,) = jobs
        directory.fail(job, "killed")
        with directory.run(job).locked():
            show(job)

    heard = Heard()
    _, (status,) = sweep([*SHARED, "seed=0"], "all", heard, run)
    assert any("running" in line for line in heard.lines)
    assert (status.standing, status.reason) == (Standing.failed, "killed")


def test_same_search_runs_once(place: Path) -> None:
    """A seed given twice is one job; a search that stands in the sweep under another name keeps that name."""
    launched = Launched()
    sweep([*SHARED, "seed=0,0"], "all", Heard(), launched)
    _, asked = sweep([*SHARED, "temperature=paper,stall"], "all", Heard(), launched)

    assert launched.calls == [["none-seed0"], ["temperature-stall-seed0"]]
    assert [status.job.name for status in asked] == ["none-seed0", "temperature-stall-seed0"]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (["ablation=none,no_prompt_archive", "seed=range(0,8)"], ["none and no_prompt_archive will find equal"]),
        (["ablation=none,no_prompt_archive", "seed=range(0,8)", "prompts=curiosity"], []),
        (["ablation=none,fixed_temperature", "seed=0,1"], ["2 seeds of an arm can show nothing", "takes 4 or more"]),
        (["ablation=none,fixed_temperature,drift", "seed=range(0,4)"], ["4 seeds of an arm", "takes 5 or more"]),
        (["ablation=none,fixed_temperature", "seed=range(0,4)"], []),
        (["seed=0,1"], []),
    ],
)
def test_what_a_sweep_cannot_show_is_said_before_it_runs(settings: list[str], told: list[str], place: Path) -> None:
    """Arms that are equal by construction, with the reason, and seeds that are too few for any test."""
    view = Heard()
    sweep([*SHARED, *settings], "all", view, Launched())
    warned = [line for line in view.lines if line.startswith("warning: ")]
    assert [words for words in told if not any(words in line for line in warned)] == []
    assert bool(warned) == bool(told)


@pytest.mark.slow
def test_seeds_of_an_arm_that_is_not_tested_are_not_too_few() -> None:
    """One that is the reference by construction may have a single seed; an arm that is tested may not."""
    seeds = {"none": 4, "fixed_temperature": 4, "no_prompt_archive": 1}
    planned = {
        Job(name=f"{arm}-seed{seed}", arm=arm, seed=seed, overrides=(), config=""): composed(
            *SHARED, "llm=grammar", f"ablation={arm}", f"seed={seed}"
        )
        for arm, count in seeds.items()
        for seed in range(count)
    }
    (told,) = shortcomings(planned, list(planned), "none")
    assert told.startswith("none and no_prompt_archive will find equal networks")
    fewer = [job for job in planned if job.name != "fixed_temperature-seed3"]
    assert any(line.startswith("3 seeds of an arm can show nothing") for line in shortcomings(planned, fewer, "none"))


@pytest.mark.slow
def test_folder_is_found_again_with_more_arms_and_seeds() -> None:
    """It follows from what the jobs share, and from nothing that leaves results alone."""
    first, more, watched, other = (
        next(iter(plan(*part([*SHARED, *settings], ())).values()))
        for settings in (
            ["ablation=none", "seed=0"],
            ["ablation=stall_temperature", "seed=3"],
            ["executor.workers=1"],
            ["search.candidates=3"],
        )
    )
    name = folder(SHARED, first)
    assert name.parent == Path("sweeps")
    assert name.name.startswith("published_force-")
    assert folder(SHARED, more) == name
    assert folder([*SHARED, "executor.workers=1"], watched) == name
    assert folder([*SHARED, "search.candidates=3"], other) != name


@pytest.mark.slow
def test_finished_jobs_are_left_alone(place: Path) -> None:
    """The same command launches nothing, and touches no file of a job."""
    launched = Launched()
    first = sweep(TWO_BY_TWO, "all", Heard(), launched)
    before = {name: files_of(place / "all" / name) for name in NAMES}
    again = sweep(TWO_BY_TWO, "all", Heard(), launched)

    assert launched.calls == [NAMES]
    assert again == first
    assert [status.standing for status in again[1]] == [Standing.finished] * 4
    assert {name: files_of(place / "all" / name) for name in NAMES} == before


def test_failed_and_stopped_jobs_are_given_again(place: Path) -> None:
    """A failure stops no other job, is shown with its reason, and is repeated; a stopped job is resumed."""
    view = Heard()
    _, first = sweep(TWO_BY_TWO, "all", view, Launched(failing=("none-seed1",)))
    assert [status.reason for status in first] == ["", "the disk is full", "", ""]
    shown = [line.partition(", the disk is full (")[2] for line in view.lines if line.startswith("none-seed1: failed")]
    assert [line.startswith("1 of 4 jobs finished") for line in shown] == [True]
    ends = [line.rpartition("jobs finished")[2] for line in view.lines if "jobs finished" in line]
    assert [" left)" in end for end in ends] == [False] * 4  # nothing was trained
    assert view.counts == [(0, 4), (1, 4), (1, 4), (2, 4), (3, 4)]

    directory = SweepDirectory(place / "all")
    stopped = directory.read().jobs[0]
    run = directory.run(stopped).read_run()
    directory.run(stopped).write_run(replace(run, digest=None))
    second = Launched()
    assert all(status.digest for status in sweep(TWO_BY_TWO, "all", Heard(), second)[1])
    assert second.calls == [["none-seed0", "none-seed1"]]


def test_carriers_of_the_temperature_are_arms(place: Path) -> None:
    """Those that carry it, and that nothing does; each is a search of its own."""
    arms = [f"temperature.carrier={carrier}" for carrier in ("parameter", "words", "effort", "none")]
    settings = [*SHARED, "temperature.carrier=parameter,words,effort,none", "seed=0"]
    _, asked = sweep(settings, "all", Heard(), launched := Launched())
    assert len({status.job.config for status in asked}) == 4
    assert [status.job.arm for status in asked] == arms
    assert launched.calls == [[f"temperature.carrier-{arm.partition('=')[2]}-seed0" for arm in arms]]


def test_more_arms_and_seeds_add_jobs(place: Path) -> None:
    """A command with others runs those only, and sweep.json lists all, each once."""
    launched = Launched()
    sweep([*SHARED, "ablation=none", "seed=0,1"], "all", Heard(), launched)
    _, asked = sweep([*SHARED, "ablation=none,fixed_temperature", "seed=1"], "all", Heard(), launched)

    assert launched.calls == [NAMES[:2], [NAMES[3]]]
    assert launched.launchers[1] == Launcher(options={"n_jobs": 1})  # of two jobs one is finished
    assert [status.job.name for status in asked] == [NAMES[1], NAMES[3]]
    assert [job.name for job in SweepDirectory(place / "all").read().jobs] == [*NAMES[:2], NAMES[3]]


CROSSED = "proposals.mutation_probability"


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("first", "then", "job"),
    [
        pytest.param([], ["search.candidates=3"], "none-seed0", marks=pytest.mark.slow),
        # An arm may override what differs, and would hide that another arm's jobs are others now.
        (["ablation=no_prompt_archive,none"], ["prompts=curiosity", "ablation=none"], "none-seed0"),
        # Where the baseline is every parent nothing is crossed, as one of the earlier jobs does: it is no search.
        ([f"{CROSSED}=0.5,1"], ["proposals.parents=baseline", f"{CROSSED}=1"], f"{CROSSED}-0.5-seed0"),
    ],
)
def test_other_shared_settings_are_another_sweep(first: list[str], then: list[str], job: str, place: Path) -> None:
    """They are compared with every job; where results cannot change, the newest hold."""
    sweep([*SHARED, *first, "seed=0"], "all", Heard(), Launched())
    with refused(RunError, place="all", got=f"{job} would be another search", remedy="choose another --into"):
        sweep([*SHARED, *then, "seed=1"], "all", Heard(), launched := Launched())
    assert not launched.calls
    sweep([*SHARED, *first, "executor.workers=1", "seed=0"], "all", Heard(), launched)
    assert "executor.workers=1" in SweepDirectory(place / "all").read().overrides
    assert not launched.calls


@pytest.mark.slow
def test_setting_that_was_varied_once_is_never_shared(place: Path) -> None:
    """One value of a setting that was varied before is not shared: its job would have the arm of another."""
    sweep([*SHARED, "temperature=paper,stall", "seed=0"], "all", Heard(), Launched())
    _, asked = sweep([*SHARED, "temperature=stall", "seed=0,1"], "all", Heard(), launched := Launched())

    assert launched.calls == [["temperature-stall-seed1"]]
    assert {status.job.arm for status in asked} == {"temperature=stall"}


def test_finished_job_has_not_failed_whatever_was_written_before(place: Path) -> None:
    """A job that was finished by hand, or whose launching process was killed, loses the reason of its failure."""
    sweep([*SHARED, "seed=0"], "all", Heard(), Launched())
    directory = SweepDirectory(place / "all")
    job = directory.read().jobs[0]
    directory.fail(job, "the disk is full")
    sweep([*SHARED, "seed=0"], "all", Heard(), launched := Launched())

    assert not launched.calls
    assert directory.failure(job) is None


def test_run_that_is_not_the_jobs_is_named(place: Path) -> None:
    """Of another configuration, or of a task whose texts in conf/ were edited since: it is neither used nor changed."""
    directory = SweepDirectory(place / "all")
    (job,) = plan(SHARED, [("ablation=none", "seed=0")])
    begin(directory, job, [*SHARED, "search.candidates=3"])
    before = files_of(place / "all" / "none-seed0")
    got, remedy = "a run whose configuration has the hash ", "move that directory away"
    with refused(RunError, place="none-seed0", got=got, remedy=remedy):
        sweep([*SHARED, "seed=0"], "all", Heard(), launched := Launched())
    assert files_of(place / "all" / "none-seed0") == before
    begin(directory, job)
    record = directory.run(job).read_run()
    directory.run(job).write_run(replace(record, task=replace(record.task, crossover="Combine.")))
    with refused(RunError, place="none-seed0", got="a run with other texts of task force", remedy="another --into"):
        sweep([*SHARED, "seed=0"], "all", Heard(), launched)
    assert not launched.calls


def test_jobs_that_would_share_a_directory_are_refused() -> None:
    """The name of a directory ends in no dot, so two values may have one name."""
    got = "llm.model-a-seed0 for llm.model=a and llm.model=a."
    with refused(ConfigError, place="jobs", expected="a directory name for each job", got=got):
        plan(SHARED, [("llm.model=a",), ("llm.model=a.",)])


def test_sweep_whose_shared_settings_are_not_a_search_is_named_by_the_user(place: Path) -> None:
    """The experiment leaves a choice open that each job makes."""
    with refused(ConfigError, place="shared overrides", got="leaves the choice of the model", remedy="--into DIR"):
        sweep(["experiment=paper_force", "llm=grammar,anthropic", "tracking=none"], None, Heard(), Launched())
    assert not list(place.iterdir())


def test_job_that_another_process_runs_is_left_to_it(place: Path) -> None:
    """Jobs of a cluster outlive the process that launched them."""
    directory = SweepDirectory(place / "all")
    (job,) = plan(SHARED, [("seed=0",)])
    with directory.run(job).locked():
        _, statuses = sweep([*SHARED, "seed=0"], "all", Heard(), launched := Launched())
    assert not launched.calls
    assert [status.standing for status in statuses] == [Standing.running]


def test_one_process_at_a_time_runs_a_sweep(place: Path) -> None:
    """Two would launch the same jobs."""
    with (
        SweepDirectory(place / "all").locked(),
        refused(RunError, place="=all", expected="an idle directory", remedy="choose another --into"),
    ):
        sweep([*SHARED, "seed=0"], "all", Heard(), Launched())
