"""Promise: what arms are compared on is written down before anything is trained, and stays as it was written."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hand_sweeps import PLAN
from refusals import refused
from sweeps import SHARED, Heard, Launched

from tacevo.bundles.publish import published_terms
from tacevo.choices import Primary, Varied
from tacevo.cli.app import main
from tacevo.config.compose import compose
from tacevo.config.identity import config_hash
from tacevo.errors import ConfigError, DivergenceError, RunError
from tacevo.results.sweep_jobs import check_jobs
from tacevo.storage.plan_file import plan_text
from tacevo.storage.sweep_directory import UNSTATED, SweepDirectory, SweepTerms
from tacevo.sweeps.search_process import overrides_of
from tacevo.sweeps.sweeping import sweep
from tacevo.sweeps.terms import Asked, read_varied

ALL = Path("all")
MODELS = [*SHARED, "temperature=paper,stall", "seed=0"]
SEEDED = (Varied.sensor, Varied.splitting)


def begun(settings: Sequence[str], asked: Asked, launched: Launched | None = None) -> SweepDirectory:
    """Begin a sweep, or go on with it; its jobs finish by themselves."""
    sweep(settings, str(ALL), Heard(), launched or Launched(), asked=asked)
    return SweepDirectory(ALL)


def test_terms_are_there_before_a_job_runs(place: Path) -> None:
    """The launcher finds them in sweep.json: a test score, and the arm that changes nothing."""
    terms = []

    class Looking(Launched):
        def __call__(self, directory: SweepDirectory, *rest: object) -> None:
            terms.append(directory.read().terms)

    begun([*SHARED, "ablation=none,fixed_temperature", "seed=0"], Asked(), Looking())
    assert terms == [SweepTerms(primary=Primary.test_score, reference="none")]


@pytest.mark.slow
def test_any_arm_may_be_the_reference(place: Path) -> None:
    """A sweep over settings states one of its own; without one it is told that nothing will be tested."""
    stated = begun(MODELS, Asked(reference="temperature=stall", primary=Primary.qd_score)).read().terms
    assert stated == SweepTerms(primary=Primary.qd_score, reference="temperature=stall")
    view = Heard()
    sweep(MODELS, "other", view, Launched())
    assert SweepDirectory(Path("other")).read().terms.reference is None
    assert any("--reference" in line for line in view.lines)


def test_reference_that_is_not_an_arm_is_refused_before_a_job_runs(place: Path) -> None:
    """With the arms that there are."""
    with refused(ConfigError, place="--reference", expected="'temperature=paper', 'temperature=stall'", got="stal"):
        begun(MODELS, Asked(reference="temperature=stal"), launched := Launched())
    assert not launched.calls
    assert not SweepDirectory(ALL).is_one


def test_terms_are_not_changed_once_they_are_stated(place: Path) -> None:
    """Not after results are there, and not before; what a later command does not mention stays."""
    directory = begun(MODELS, Asked(reference="temperature=stall"))
    before = (ALL / "sweep.json").read_bytes()
    for asked, name in (
        (Asked(reference="temperature=paper"), "reference"),
        (Asked(primary=Primary.coverage), "primary"),
        (Asked(vary=SEEDED), "vary"),
    ):
        with refused(RunError, place=f"terms.{name}", expected="as stated when the sweep began", remedy=f"--{name}"):
            begun([*SHARED, "temperature=paper", "seed=2"], asked, launched := Launched())
        assert not launched.calls
        assert (ALL / "sweep.json").read_bytes() == before
    begun([*SHARED, "temperature=paper", "seed=2"], Asked())
    assert directory.read().terms.reference == "temperature=stall"
    assert len(directory.read().jobs) == 3


def test_sweep_of_an_earlier_release_keeps_its_bytes(place: Path) -> None:
    """It states nothing, and nobody states anything for it when jobs are added."""
    directory = begun([*SHARED, "seed=0"], Asked())
    told = json.loads((ALL / "sweep.json").read_text())
    del told["terms"]
    (ALL / "sweep.json").write_text(json.dumps(told))
    assert directory.read().terms == UNSTATED
    assert json.loads(directory.read().text) == told
    begun([*SHARED, "seed=0,1"], Asked())
    assert "terms" not in json.loads((ALL / "sweep.json").read_text())
    with refused(RunError, expected="none stated"):
        begun([*SHARED, "seed=0,1"], Asked(reference="none"))


@pytest.mark.parametrize(
    ("terms", "place_of"),
    [
        ({"primary": "luck"}, "terms.primary"),
        ({"vary": ["seed"]}, "terms.vary.0"),
        ({"retraining": {"seeds": 0, "epochs": 1, "choose": "fitness"}}, "terms.retraining.seeds"),
        ({"note": 1}, "terms.note"),
    ],
)
def test_damaged_terms_are_named(terms: object, place_of: str, place: Path) -> None:
    """As all of sweep.json is."""
    Path("sweep.json").write_text(json.dumps({"schema": 1, "overrides": [], "jobs": [], "terms": terms}))
    with refused(RunError, place=place_of):
        SweepDirectory(place).read()


@pytest.mark.slow
def test_data_follow_from_the_seed_of_a_job_only_where_the_sweep_says_so(place: Path) -> None:
    """Each job runs as its command line would, and arms keep their names; nobody says so after the fact."""
    directory = begun([*SHARED, "ablation=none,fixed_temperature", "seed=3,4"], Asked(vary=SEEDED))
    jobs = directory.read().jobs
    assert {job.arm for job in jobs} == {"none", "fixed_temperature"}
    for job in jobs:
        config = compose(overrides_of(directory, job))
        assert (config.data.split_seed, config.data.sensor_seed) == (job.seed, job.seed)
        assert config_hash(config) == job.config
    check_jobs(directory)
    directory.write(replace(directory.read(), terms=UNSTATED))
    with refused(DivergenceError, place="job none-seed4", expected="the settings of arm 'none', except for the seed"):
        check_jobs(directory)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("settings", "vary", "got"),
    [
        (["data.split_seed=1"], Varied.splitting, "which an override sets"),
        (["data.sensor_seed=1,2"], Varied.sensor, "which an override sets"),
        (["data=tacverse", "data.root=x", "data.split=random"], Varied.sensor, "without simulated data"),
        (["data=tacverse", "data.root=x", "data.split=release"], Varied.splitting, "without data.split=random"),
    ],
)
def test_setting_that_cannot_follow_from_the_seed_is_refused(
    settings: list[str], vary: Varied, got: str, place: Path
) -> None:
    """It is set already, or has no effect: the data would not vary, and a reader would believe that they do."""
    with refused(ConfigError, place="--vary", got=got):
        begun([*SHARED, *settings, "seed=0"], Asked(vary=(vary,)), launched := Launched())
    assert not launched.calls


@pytest.mark.slow
def test_plan_is_stated_with_the_sweep_and_stays(place: Path) -> None:
    """It is copied: a file that is changed later changes nothing. One of another task has another spread."""
    Path("plan.json").write_text(plan_text(replace(PLAN, task="grating")))
    with refused(ConfigError, place="plan.json, task", expected="'force'", got="'grating'"):
        begun(MODELS, Asked(plan=Path("plan.json")), launched := Launched())
    assert not launched.calls
    Path("plan.json").write_text(plan_text(PLAN))
    directory = begun(MODELS, Asked(plan=Path("plan.json")))
    Path("plan.json").write_text(plan_text(replace(PLAN, seeds=4)))
    with refused(RunError, place="terms.plan", expected="the plan for 12 jobs of each arm", got="for 4 jobs"):
        begun(MODELS, Asked(plan=Path("plan.json")))
    assert directory.read().terms.plan == PLAN


@pytest.mark.parametrize("option", ["--reference=none", "--primary=coverage", "--vary=data.seed", "--plan=plan.json"])
def test_one_search_has_no_terms(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    """There is nothing to compare it with."""
    assert main(["search", *SHARED, option]) == 2
    assert "terms of a sweep, so they need -m" in capsys.readouterr().err


def test_varied_settings_are_read_from_the_command_line() -> None:
    """In one order, whatever the user's."""
    assert read_varied("data.split_seed,data.sensor_seed,data.split_seed") == SEEDED
    for wrong in ("", "seed", "data.split_seed, data.sensor_seed", "data.images"):
        with refused(ConfigError, place="--vary", expected="data.split_seed"):
            read_varied(wrong)


def test_published_reference_has_the_published_name() -> None:
    """An arm that is a path is published by its last part, and so is the reference that names it."""
    terms = SweepTerms(reference="data.root=/home/ada/force")
    assert published_terms(terms, {"data.root=/home/ada/force": "data.root=force"}).reference == "data.root=force"
    assert published_terms(UNSTATED, {"none": "none"}) == UNSTATED
