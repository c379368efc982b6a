"""Promise: a plan is kept, and sealed, by the study or sweep that follows it."""

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from refusals import refused

import tacevo
from tacevo.api.planning import _sweep
from tacevo.choices import Primary
from tacevo.cli.app import main
from tacevo.errors import ConfigError, RunError
from tacevo.results.study_directory import studies_of
from tacevo.storage.plan_file import read_plan
from tacevo.storage.sweep_directory import SweepDirectory

pytestmark = pytest.mark.timeout(300)

PLAN = Path("build/plan/plan.json")


def test_study_keeps_its_plan(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is sealed with the scores, a replay compares it, and the tables show it; no training is another one."""
    assert main(["plan", "study", "run", "--effect", "0.5", "--comparisons", "1"]) == 0
    written = json.loads(PLAN.read_text())
    assert (written["kind"], written["task"], written["metric"]) == ("study", "force", "mse")
    assert f"plan.json, made on {written['made']}, by its machine's clock" in capsys.readouterr().out
    assert main(["study", "run=run", "elites=1", "seeds=4", "epochs=1", f"plan={PLAN}"]) == 0
    told = capsys.readouterr()
    assert "(4 trainings" not in told.err
    assert "(8 of 8 trainings recorded already)" in told.err
    (study,) = (path for path in folder.glob("run/studies/*/study.json") if json.loads(path.read_text())["plan"])
    assert json.loads(study.read_text())["plan"] == written
    assert main(["replay", "run"]) == 0
    assert main(["tables", "run"]) == 0
    notes = [path.read_text() for path in folder.glob("run/tables/more/*/scores.md")]
    assert any(f"Planned: {written['seeds']} seeds of each network" in note for note in notes)


def test_plan_bears_the_day_on_which_it_was_written(folder: Path) -> None:
    """That of the clock, in UTC."""
    before = datetime.now(UTC).date().isoformat()
    assert main(["plan", "study", "run", "--effect", "0.5"]) == 0
    assert before <= read_plan(PLAN, "study", "force").made <= datetime.now(UTC).date().isoformat()


def test_plan_from_python_is_the_commands(folder: Path, sweep: Path) -> None:
    """The same file, of an open run or its path, and the table that the command prints; a wrong number is refused."""
    assert main(["plan", "study", "run", "--effect", "0.5", "--power", "0.9"]) == 0
    run = tacevo.open("run")
    assert isinstance(run, tacevo.Run)
    table = tacevo.plan("study", run, effect=0.5, power=0.9, output="mine")
    written, ours = (json.loads(path.read_text()) for path in (PLAN, Path("mine/plan.json")))
    assert {**ours, "made": ""} == {**written, "made": ""}
    assert table.frame.query("plan == 'chosen'")["seeds"].tolist() == [written["seeds"]]
    assert tacevo.plan("study", "run", effect=0.5, power=0.9).to_markdown() == table.to_markdown()
    wishes: list[dict[str, Any]] = [{"effect": 0.0}, {"effect": 0.5, "alpha": 1.0}, {"effect": 0.5, "comparisons": 0}]
    for wrong in wishes:
        with refused(ConfigError, place=[*wrong][-1]):
            tacevo.plan("study", run, **wrong)
    with refused(RunError, place="run", expected="the directory or bundle of a sweep"):
        tacevo.plan("sweep", run, effect=0.5)


def test_plan_of_an_earlier_release_has_no_day(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is followed all the same, and what seals it is as it was: the header has no day either."""
    assert main(["plan", "study", "run", "--effect", "0.5", "--comparisons", "1"]) == 0
    older = json.loads(PLAN.read_text())
    del older["made"]
    PLAN.write_text(json.dumps(older))
    assert main(["study", "run=run", "elites=1", "seeds=4", "epochs=1", f"plan={PLAN}"]) == 0
    (directory,) = (one for one in studies_of(folder / "run") if one.read().plan)
    assert "made" not in directory.scores.read_text().splitlines()[0]
    assert main(["replay", "run"]) == 0


def test_pilot_may_be_one_study_of_a_run(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where the run has one only, it says what the run says."""
    told = []
    for pilot in (run, *run.glob("studies/*")):
        assert main(["plan", "study", str(pilot), "--effect", "0.5"]) == 0
        told.append(capsys.readouterr().out)
    assert told[0] == told[1]
    assert len(told) == 2


def test_edited_plan_of_a_study_is_found(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A plan that is fitted to the results afterwards is not a plan."""
    assert main(["plan", "study", "run", "--effect", "0.5"]) == 0
    assert main(["study", "run=run", "elites=1", "seeds=4", "epochs=1", f"plan={PLAN}"]) == 0
    (study,) = (path for path in folder.glob("run/studies/*/study.json") if json.loads(path.read_text())["plan"])
    described = json.loads(study.read_text())
    described["plan"]["seeds"] += 1
    study.write_text(json.dumps(described))
    assert main(["replay", "run"]) == 1
    assert "plan.seeds" in capsys.readouterr().err


@pytest.mark.slow
def test_sweep_states_its_plan(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is in sweep.json, and below the table of the arms."""
    assert main(["plan", "sweep", str(sweep), "--effect", "0.5", "--power", "0.5"]) == 0
    plan = read_plan(PLAN, "sweep", "force")
    directory = SweepDirectory(sweep)
    stated = directory.read()
    terms = replace(stated.terms, primary=Primary.best_fitness, reference="none", plan=plan)
    directory.write(replace(stated, terms=terms))
    assert main(["show", str(sweep)]) == 0
    assert f"planned: {plan.seeds} jobs of each of 2 arms, made on {plan.made}" in capsys.readouterr().out
    assert main(["ablations", str(sweep), "-o", "out"]) == 0
    assert f"Planned: {plan.seeds} jobs of each arm" in Path("out/ablation.md").read_text()


def test_pilot_without_a_study_is_refused(sweep: Path, published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With what to do; and a run is not a sweep."""
    job = sweep / "none-seed0"
    assert main(["plan", "study", str(job), "--effect", "0.1"]) == 2
    assert f"expected at least one finished study; got none; `tacevo study {job}`" in capsys.readouterr().err
    assert main(["plan", "sweep", str(job), "--effect", "0.1"]) == 2
    assert "expected the directory or bundle of a sweep" in capsys.readouterr().err
    with refused(RunError, place="run.zip", got="the bundle of a run"):
        _sweep(published / "run.zip")
    assert not PLAN.exists()


@pytest.mark.parametrize(
    "option",
    [
        ["--effect", "0"],
        ["--effect", "1"],
        ["--effect", "10%"],
        ["--power", "x"],
        *(["--comparisons", n] for n in "0x"),
    ],
)
def test_wrong_option_is_refused(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Before any pilot is read."""
    assert main(["plan", "study", ".", "--effect", "0.1", *option]) == 2
    error = capsys.readouterr().err
    assert f"{option[0]}: expected" in error
    assert f"got {option[1]}" in error


@pytest.mark.parametrize(
    ("text", "place_of"),
    [("", ""), ("{}", ""), ('{"schema": 2}', "schema"), (None, "")],
)
def test_file_that_is_not_a_plan_is_refused(text: str | None, place_of: str, tmp_path: Path) -> None:
    """Missing, empty, or of another layout."""
    path = tmp_path / "plan.json"
    if text is not None:
        path.write_text(text)
    with refused(ConfigError, place=place_of or str(path), remedy="`tacevo plan study` writes"):
        read_plan(path, "study", "force")


def test_plan_of_another_kind_or_task_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A study does not follow the plan of a sweep, nor that of another sensor's task."""
    assert main(["plan", "study", "run", "--effect", "0.5"]) == 0
    with refused(ConfigError, place="plan.json, kind", got="'study'"):
        read_plan(PLAN, "sweep", "force")
    with refused(ConfigError, place="plan.json, task", got="'force'"):
        read_plan(PLAN, "study", "grating")


def test_wish_without_a_plan_leaves_an_earlier_one_as_it_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It says its own effect and its own day; the exit status says that there is no other."""
    assert main(["plan", "study", "run", "--effect", "0.9", "--comparisons", "1"]) == 0
    earlier = PLAN.read_bytes()
    assert main(["plan", "study", "run", "--effect", "0.0001", "--comparisons", "1"]) == 1
    assert PLAN.read_bytes() == earlier
