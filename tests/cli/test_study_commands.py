"""Promise: `tacevo study --help` tells every setting with its default, and progress suits the console."""

import io
import re
from dataclasses import asdict
from pathlib import Path

import pytest
from refusals import refused
from rich.console import Console

from tacevo.choices import MarginKind
from tacevo.cli.app import main
from tacevo.cli.settings import NOISE, STUDY
from tacevo.config.compose import compose_noise, compose_study
from tacevo.config.schema import keys
from tacevo.config.study import NoiseConfig, StudyConfig
from tacevo.errors import ConfigError
from tacevo.runs.progress import Progress

#: Groups, and what `executor=` chooses.
UNTOLD = {"executor.kind", "store", "margins", "margins.regression", "margins.classification"}


def test_every_setting_is_told() -> None:
    """What a study or a noise run takes stands in its help, and nothing else."""
    assert STUDY.keys() == set(keys(StudyConfig)) - UNTOLD
    assert NOISE.keys() == set(keys(NoiseConfig)) - UNTOLD


def test_told_defaults_are_the_shipped_ones(capsys: pytest.CaptureFixture[str]) -> None:
    """The number in brackets is what conf/study.yaml has: the paper's four elites and twenty seeds, our 50 epochs."""
    with pytest.raises(SystemExit, match="0"):
        main(["study", "--help"])
    rows = re.sub(r"\n {10,}", " ", capsys.readouterr().out)
    told = dict(re.findall(r"^  (\S+) .*\(([\d.]+)\)$", rows, re.MULTILINE))
    config = compose_study(["run=x"])
    margins = config.margins
    shipped = {
        **asdict(config),
        "executor.workers": config.executor.workers,
        "margins.regression.value": margins.regression.value,
        "margins.classification.value": margins.classification.value,
    }
    assert told.keys() == {
        *("elites", "seeds", "epochs", "seconds", "memory_mib", "executor.workers"),
        *("alpha", "margins.regression.value", "margins.classification.value"),
    }
    assert (margins.regression.kind, margins.classification.kind) == (MarginKind.relative, MarginKind.absolute)
    assert {key: float(value) for key, value in told.items()} == {key: float(shipped[key]) for key in told}
    assert (config.elites, config.seeds, config.epochs, config.store.root) == (4, 20, 50, None)


@pytest.mark.parametrize(
    ("override", "place", "expected"),
    [
        ("run=", "run", "the directory of a finished run"),
        ("elites=0", "elites", "an integer of at least 1"),
        ("choose=luck", "choose", "'fitness', 'reestimated' or 'validated'"),
        ("seeds=0", "seeds", "an integer of at least 1"),
        ("epochs=ten", "epochs", "an integer"),
        ("seconds=0", "seconds", "a number above 0"),
        ("memory_mib=63", "memory_mib", "an integer of at least 64"),
        ("alpha=1", "alpha", "a number below 1"),
        ("margins.regression.value=0", "margins.regression.value", "a number above 0"),
        ("margins.classification.value=inf", "margins.classification.value", "a finite number"),
        ("margins.regression.kind=both", "margins.regression.kind", "'relative', 'errors' or 'absolute'"),
        ("store.root=''", "store.root", "text that is not empty"),
        ("executor.workers=0", "executor.workers", "an integer of at least 1"),
        ("executor=slurm", "executor", "one of local"),
        ("+new=1", "", "KEY=VALUE"),
    ],
)
def test_wrong_setting_is_refused_by_its_name(override: str, place: str, expected: str) -> None:
    """As a setting of a search is."""
    with refused(ConfigError, place=place, expected=expected):
        compose_study(["run=x", override] if not override.startswith("run") else [override])


def test_study_of_a_sweep_follows_from_the_sweep() -> None:
    """Of each job the best elite is trained unless more are asked for; the plan was stated when the sweep began."""
    assert compose_study(["run=x", "executor.per_gpu=3"]).executor.per_gpu == 3
    assert [compose_study(["sweep=x", *more]).elites for more in ([], ["elites=5"])] == [1, 5]
    with refused(ConfigError, place="plan", got="plan.json", expected="no value with sweep="):
        compose_study(["sweep=x", "plan=plan.json"])


@pytest.mark.parametrize(
    ("override", "remedy"),
    [
        ("executor.worker=2", "did you mean executor.workers?"),
        ("task=force", "`tacevo study --help` lists the settings"),
    ],
)
def test_unknown_setting_is_refused(override: str, remedy: str) -> None:
    """In the words of a study, not of a search."""
    with refused(ConfigError, got="not a setting", remedy=remedy):
        compose_study(["run=x", override])


@pytest.mark.parametrize("margins", ["margins", "margins.regression"])
def test_value_for_what_only_holds_settings_names_these(margins: str) -> None:
    """A margin is a value and a kind."""
    with refused(ConfigError, place=margins, got="0.2", remedy="set margins.regression.value or "):
        compose_study(["run=x", f"{margins}=0.2"])


@pytest.mark.parametrize("override", ["elites=0", "elites=some"])
def test_elites_of_a_noise_run_are_all_or_a_number(override: str) -> None:
    """Unless set, all."""
    assert (compose_noise(["run=x"]).elites, compose_noise(["run=x", "elites=3"]).elites) == ("all", 3)
    with refused(ConfigError, expected="all, or an integer of at least 1"):
        compose_noise(["run=x", override])


@pytest.mark.parametrize("command", ["study", pytest.param("noise", marks=pytest.mark.room("noise"))])
def test_run_is_a_setting_or_a_bare_word(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Wherever it stands, and although its name looks like a setting; two runs are refused, and so is none."""
    place = tmp_path / "run=1"
    place.mkdir()
    for words in (["seeds=5", str(place)], [str(place)], [f"run='{place}'", "seeds=5"]):
        assert main([command, *words]) == 2
        assert capsys.readouterr().err.startswith(f"error: {place}: expected the directory of a run")
    for other in (f"run={tmp_path}", f"sweep={tmp_path}", "networks=b.py"):
        assert main([command, str(tmp_path), other]) == 2
        told = f"run: expected one run, as RUN or run=RUN; got {tmp_path}, {other}\n"
        assert capsys.readouterr().err == f"error: {told}"
    assert main([command, str(tmp_path), "task=force"]) == 2
    assert "task: not a setting" in capsys.readouterr().err
    assert main([command, "seeds=5"]) == 2
    assert "run: expected the directory of a finished run" in capsys.readouterr().err


@pytest.mark.parametrize("terminal", [True, False])
def test_bars_are_for_terminals(terminal: bool) -> None:
    """A bar a name, with how many are done and a note, below what is said; a log gets the lines only."""
    text = io.StringIO()
    with Progress(Console(file=text, force_terminal=terminal, width=120)) as view:
        view.advance("images", 5, 10)
        view.say("a [line]")
        view.advance("trainings", 3, 8, "best 0.1")
    assert "a [line]" in text.getvalue()
    for bar in (r"images.*5/10", r"trainings.*3/8.*best 0.1"):
        assert bool(re.search(bar, text.getvalue())) == terminal
