"""Promise: a printed command can be typed as it stands, whatever a directory, an address or a setting is called."""

import re
import shlex
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from tacevo.bundles.readme import _origin
from tacevo.cli.app import main
from tacevo.config.compose import compose, compose_study
from tacevo.errors import RunError
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.sweep_directory import SweepDirectory, SweepRecord
from tacevo.text import as_override

#: The name of a directory in which a shell and Hydra would each read something else.
HOSTILE = 'it\'s [a] "b", ${c}; (1=2) & #3'


def printed(text: str) -> list[list[str]]:
    """Return the words of each command that stands between backticks."""
    return [shlex.split(command) for command in re.findall("`(tacevo [^`]*)`", text)]


@pytest.mark.slow
@settings(max_examples=15)  # each composes a configuration
@given(st.text("ab1/. '\"\\$[]{},:=()~#&*|!%ü-@\n", min_size=1))
def test_any_text_can_be_the_value_of_a_setting(value: str) -> None:
    """Hydra reads it back, quotes, backslashes and what looks like an interpolation among it."""
    assert compose(["data=folder", as_override("data.root", value)]).data.root == value


@pytest.mark.parametrize("word", ["null", "True", "5", "1e5", "nan"])
def test_word_that_hydra_would_read_as_something_else_is_quoted(word: str) -> None:
    """A directory may be called so."""
    assert compose(["data=folder", as_override("data.root", word)]).data.root == word


def test_plain_value_needs_no_quotes() -> None:
    """What most paths are is shown as it is."""
    assert as_override("run", "runs/force-seed0-1a2b.x") == "run=runs/force-seed0-1a2b.x"


@pytest.mark.room("mlflow")
def test_store_is_looked_at_by_a_command_that_can_be_typed() -> None:
    """A shell puts the variable in, and leaves its value whole."""
    from tacevo.tracking.address import viewing

    uri = f"sqlite:////home/{HOSTILE}/mlflow.db"
    assert shlex.split(viewing(uri, "mlflow")) == ["mlflow", "ui", "--backend-store-uri", uri]
    assert viewing("", "mlflow") == 'mlflow ui --backend-store-uri "$MLFLOW_TRACKING_URI"'


@pytest.mark.room("mlflow")
def test_warning_of_the_mirror_names_the_run(tmp_path: Path) -> None:
    """Its command writes what is missing."""
    from tacevo.tracking.tracker import Mirror

    mirror = Mirror([tmp_path / HOSTILE], uri="sqlite:///mlflow.db", experiment="tacevo")  # which is missing
    assert printed(mirror.finish(None) or "") == [["tacevo", "track", str(tmp_path / HOSTILE)]]


@pytest.mark.room("noise")
def test_run_without_a_noise_run_names_the_command_that_makes_one(tmp_path: Path) -> None:
    """The run may be called anything."""
    from tacevo.results.noise_runs import noise_digest

    run: Any = SimpleNamespace(directory=RunDirectory(tmp_path / HOSTILE), ledger=SimpleNamespace(digest=""))
    with refused(RunError, remedy="run `tacevo noise ") as raised:
        noise_digest(run)
    assert printed(raised.value.remedy) == [["tacevo", "noise", str(tmp_path / HOSTILE)]]


@pytest.mark.room("page", "plans, pilots")
def test_run_without_a_study_names_the_command_that_makes_one(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beside its tables, and as a pilot of a plan; of a sweep, all jobs can be studied."""
    shutil.rmtree(run / "studies")
    run.rename(HOSTILE)
    assert main(["plan", "study", HOSTILE, "--effect", "0.1"]) == 2
    assert main(["report", HOSTILE, "-o", "report.html"]) == 0
    for words in printed(capsys.readouterr().err):
        assert words == ["tacevo", "study", HOSTILE]
    SweepDirectory(Path(HOSTILE)).write(SweepRecord(overrides=(), jobs=()))
    assert main(["study", f"run='{HOSTILE}'".replace("it's", r"it\'s").replace("${", r"\${")]) == 2
    (named,) = re.findall("JOB; (.*) takes all jobs", capsys.readouterr().err)
    assert compose_study(shlex.split(named)).sweep == HOSTILE


@pytest.mark.room("simulator", "data check")
def test_exported_images_are_read_by_the_command_that_is_printed(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the directory is called."""
    small = ["task=force", "n=10", "data.image_size=16"]
    assert main(["data", "simulate", *small, f"out=made/{HOSTILE}"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("read them: ")]
    assert compose(shlex.split(line)[5:]).data.root == f"made/{HOSTILE}"


def test_simulated_images_of_a_bundle_are_made_by_the_command_of_its_readme() -> None:
    """A shell takes no bracket of it for a pattern."""
    run = SimpleNamespace(
        config=compose(["task=grating"]), record=SimpleNamespace(task=SimpleNamespace(name="grating"))
    )
    command = _origin(cast(Any, run), "run").splitlines()[-1]
    assert "'data.spacings_mm=[" in command
    assert compose(shlex.split(command)[3:-1]).data == compose(["task=grating"]).data


def test_settings_of_a_sweep_are_shown_as_they_were_typed(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A value with a space is still one word."""
    overrides = ("experiment=demo", f"data.root='{HOSTILE}'")
    SweepDirectory(place).write(SweepRecord(overrides=overrides, jobs=()))
    assert main(["show", str(place)]) == 0
    shown = capsys.readouterr().out.partition(": 0 jobs")[0]
    assert tuple(shlex.split(shown)[2:]) == overrides


def test_job_behind_a_sweep_is_answered_with_the_name_of_its_run(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A job is no candidate: what is wrong is said of the sweep, and not of the form of an id."""
    SweepDirectory(place).write(SweepRecord(overrides=(), jobs=()))
    assert main(["show", str(place), "none-seed0"]) == 2
    assert f"a job of it is named {place}/JOB; got none-seed0" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [["show"], pytest.param(["export", "-o", "network"], marks=pytest.mark.room("export"))],
    ids=lambda words: words[0],
)
def test_what_is_no_id_is_answered_with_one(
    command: list[str], published: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A reader at a shell has no `run.candidates` to look into."""
    name, *options = command
    assert main([name, str(published / "run"), "best", *options]) == 2
    said = capsys.readouterr().err
    assert "such as g02s03" in said
    assert "got 'best'" in said
    assert not (place / "network").exists()
