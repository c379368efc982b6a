"""Promise: a sweep whose jobs are not a comparison is published without one, and the user is told why."""

import json
import shutil
from pathlib import Path

import pytest
from refusals import refused

from tacevo.api.pages import table_files
from tacevo.bundles.open import located
from tacevo.bundles.verify import Rerun, rerun
from tacevo.cli.app import main
from tacevo.errors import IncomparableError, RunError
from tacevo.results.run import read_run
from tacevo.runs.progress import Progress


def rerun_all(sweep: Path, store: Path) -> list[Rerun]:
    """Run every search of a sweep again."""
    return [rerun(read_run(run, str(store)), Progress()) for run in located(sweep).runs]


def test_why_there_is_no_comparison_is_told(sweep: Path, swept: Path) -> None:
    """The tables of the runs stay; the message names no private directory."""
    whole = table_files(sweep, rerun_all(sweep, swept / "cache"), str)
    path = sweep / "none-seed1" / "run.json"
    run = json.loads(path.read_text())
    run["versions"]["numpy"] = "1.0"
    path.write_text(json.dumps(run))
    said: list[str] = []
    fewer = table_files(sweep, rerun_all(sweep, swept / "cache"), said.append)
    said.remove("making the tables again")
    assert fewer.keys() < whole.keys()
    assert said[0].startswith("no table or figure compares the arms: ")
    assert "numpy" in said[0]
    assert str(sweep.parent) not in said[0]
    assert len(said) == 1


def test_other_fault_is_no_reason_to_leave_the_comparison_out(sweep: Path, swept: Path) -> None:
    """A list that has a seed twice is wrong, and not merely incomparable."""
    shutil.copytree(sweep / "none-seed0", sweep / "again")
    told = json.loads((sweep / "sweep.json").read_text())
    told["jobs"].append({**told["jobs"][0], "name": "again"})
    (sweep / "sweep.json").write_text(json.dumps(told))
    with refused(RunError, got="2 jobs of arm none with seed 0") as caught:
        table_files(sweep, rerun_all(sweep, swept / "cache"), str)
    assert not isinstance(caught.value, IncomparableError)


def test_bundle_is_shown_as_its_run_is(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With what its study found, which the bundle's own stores tell."""
    shown = []
    for place in ("run", "run.zip"):
        assert main(["show", str(published / place)]) == 0
        shown.append(capsys.readouterr().out)
    directory, bundle = (text[text.index("## elites1-seeds4-epochs1-") :] for text in shown)
    assert directory == bundle
    assert "verdict (p)" in bundle
    assert "re-estimated" in bundle
