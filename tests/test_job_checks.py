"""Promise: a sweep.json that says of a job what its run does not is found out, and the job is named."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tacevo.composition import compose
from tacevo.errors import DivergenceError, RunError
from tacevo.job_checks import check_jobs
from tacevo.opening import opened
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


def test_published_sweep_passes_although_defaults_have_changed() -> None:
    """The bundle of an earlier version is not what its overrides give today, where they name no setting of the two."""
    with opened(Path(__file__).parents[1] / "cache" / "published" / "ablation-force-grammar.zip") as source:
        sweep = SweepDirectory(source.folder)
        config, _, _ = read_run(sweep.run(sweep.read()[1][0]))
        assert config.archive.eff_ratio_scale is not compose(["experiment=demo"]).archive.eff_ratio_scale
        assert check_jobs(sweep) == ()


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
    edit(sweep, lambda told: told.update(overrides=["search.candidate=2"]))
    refused(sweep, "the overrides of job none-seed0 give no configuration here: ")


def forged(sweep: Path) -> None:
    """Call a sweep of the method on the grammar one of a model, and its arm an ablation, as somebody might sell it."""
    shutil.rmtree(sweep / "fixed_temperature-seed0")

    def change(told: Json) -> None:
        told["jobs"] = told["jobs"][:2]
        told["overrides"] += ["llm=anthropic", "training=paper"]
        for job in told["jobs"]:
            job.update(arm="no_qd", overrides=["ablation=no_qd", f"seed={job['seed']}"])

    edit(sweep, change)


def of_another_version(sweep: Path) -> None:
    """Let the runs be made by a version whose defaults nobody knows."""
    for path in sweep.glob("*/run.json"):
        run = json.loads(path.read_text())
        run["versions"]["tacevo"] = "0.0.1"
        path.write_text(json.dumps(run))


@pytest.mark.parametrize("is_ours", [True, False])
def test_choices_that_all_jobs_claim_are_held_against_the_runs(is_ours: bool, sweep: Path) -> None:
    """Model, training and arm are files, and every setting in them is claimed; whatever the version."""
    forged(sweep)
    if not is_ours:
        of_another_version(sweep)
    refused(sweep, "job none-seed0: its overrides give config.archive.k")


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("llm=anthropic", "config.llm."),
        ("training=paper", "config.training."),
        ("experiment=paper_force", "config."),
        ("task=grating", "task."),
        ("search={candidates:9}", "config.search.candidates=9"),
        ("search={generations:9}", "generations=9"),
    ],
)
def test_shared_choice_is_held_under_another_version_too(override: str, words: str, sweep: Path) -> None:
    """What a file or a group sets is claimed by who names it."""
    of_another_version(sweep)
    check_jobs(SweepDirectory(sweep))
    edit(sweep, lambda told: told.update(overrides=[*told["overrides"], override]))
    refused(sweep, f"job none-seed0: its overrides give {words}")


def test_dropped_setting_is_found_where_this_version_made_the_runs(sweep: Path) -> None:
    """It is not told as one with the default; another version may have had another default, which no file names."""

    def drop(told: Json) -> None:
        told["overrides"].remove("archive.samples=100")

    edit(sweep, drop)
    refused(sweep, "job none-seed0: its overrides give config.archive.samples=")
    of_another_version(sweep)
    assert check_jobs(SweepDirectory(sweep)) == ()


@pytest.mark.parametrize(
    "override",
    [
        "llm.model=${oc.env:HOME}",
        r"llm.model=$\{oc.env\:HOME\}",
        "experiment=../../secret",
        "task=[../../secret]",
        "ablation='../experiment/demo'",
        "task@_global_=force",
        "+task=force",
        "data={root:/home}",
    ],
)
def test_override_that_reads_elsewhere_is_not_composed(override: str, sweep: Path) -> None:
    """Neither a variable of the environment nor a file beside conf/ is read for a stranger, and then shown."""
    edit(sweep, lambda told: told.update(overrides=[*told["overrides"], override]))
    with pytest.raises(RunError, match=re.escape(f"has the override {override!r}, which is not read")):
        check_jobs(SweepDirectory(sweep))


def rename_arm(sweep: Path, *, arm: str, to: str) -> None:
    """Give an arm a name that no file of conf/ has."""

    def change(told: Json) -> None:
        for job in told["jobs"]:
            if job["arm"] == arm:
                job.update(arm=to, overrides=[f"ablation={to}", f"seed={job['seed']}"])

    edit(sweep, change)


def test_choice_that_is_not_here_is_told(sweep: Path) -> None:
    """A publisher's own task or arm is no fault, and no silence either; the other jobs are compared."""
    rename_arm(sweep, arm="fixed_temperature", to="own")
    (told,) = check_jobs(SweepDirectory(sweep))
    assert told.startswith("NOT compared: whether the runs of jobs fixed_temperature-seed0 have the settings that")
    assert "chooses ablation=own, which is not in this version's conf/" in told
    edit(sweep, lambda told: told.update(overrides=[*told["overrides"], "task=own"]))
    (told,) = check_jobs(SweepDirectory(sweep))
    assert "jobs none-seed0, none-seed1, fixed_temperature-seed0 have" in told
    assert "task=own, ablation=own, which is not" in told


def test_choice_that_is_not_here_hides_no_other_job(sweep: Path) -> None:
    """Where the arm of one job is not known, a lie about another is found as ever."""
    rename_arm(sweep, arm="fixed_temperature", to="own")
    rename_arm(sweep, arm="none", to="no_qd")
    refused(sweep, "job none-seed0: its overrides give config.archive.k")


def test_arm_that_is_not_here_has_settings_of_its_own(sweep: Path) -> None:
    """Runs of two arms under one name, or one arm under two names, are found without knowing either."""
    rename_arm(sweep, arm="fixed_temperature", to="own")
    rename_arm(sweep, arm="none", to="own")
    refused(sweep, "runs of the arm 'own' differ in more than their seeds, job fixed_temperature-seed0 too")
    edit(sweep, lambda told: told["jobs"][1].update(arm="mine", overrides=["ablation=mine", "seed=1"]))
    edit(sweep, lambda told: told["jobs"].pop())
    refused(sweep, "the arms 'own' and 'mine' have runs of the same settings")


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
