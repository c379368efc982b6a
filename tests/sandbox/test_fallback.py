"""Promise: a wall that is missing is named; a run that demands it is refused, and others compute the same."""

import json
from pathlib import Path

import pytest
from commands import tacevo
from interruptions import SEARCH
from smallest import SMALLEST, UNTRACKED

from tacevo.choices import Confinement
from tacevo.sandbox.confinement import available

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.skipif(available() is not Confinement.kernel, reason="the kernel has no wall that could be hidden"),
]

WEAKER = "from weaker_machine import lose_landlock; lose_landlock()"


def test_search_that_demands_the_walls_is_refused(tmp_path: Path) -> None:
    """The user is told in one line what is missing and what to do, and nothing is left behind."""
    command = ["search", "experiment=demo", "sandbox.require=kernel", "tracking=none"]
    done = tacevo(*command, cwd=tmp_path, before=WEAKER, status=2)
    assert (
        "sandbox.require: expected a machine that offers the level kernel; got process: a kernel without Landlock"
        in done.stderr
    )
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_doctor_names_the_missing_wall(tmp_path: Path) -> None:
    """A machine that is weaker is still fit for a search, and its report says where it is weaker."""
    done = tacevo("doctor", cwd=tmp_path, before=WEAKER)
    assert "level: process" in done.stdout
    assert "landlock: missing" in done.stdout
    assert "seccomp: a short list" in done.stdout


@pytest.mark.slow
def test_doctor_names_the_walls_that_stand(tmp_path: Path) -> None:
    """On this machine nothing is missing, and the checks, which really try, find it sound."""
    done = tacevo("doctor", cwd=tmp_path)
    assert "ok   sandbox" in done.stdout
    assert "FAIL" not in done.stdout
    assert "level: kernel" in done.stdout
    assert "missing" not in done.stdout


@pytest.mark.slow
def test_run_that_is_continued_on_a_weaker_machine_says_so(tmp_path: Path) -> None:
    """Each way in which candidates were held stands in run.json, in the order in which they came."""
    small = ["search", *SMALLEST, UNTRACKED, "run.dir=run", "search.initial=2", "search.candidates=2"]
    for before, generations in (("", 0), (WEAKER, 1)):
        tacevo(*small, f"search.generations={generations}", cwd=tmp_path, before=before)
    first, second = json.loads((tmp_path / "run" / "run.json").read_text())["confinement"]
    assert (first["level"], second["level"]) == ("kernel", "process")
    assert "no access to files" in first["landlock"]
    assert second["landlock"].startswith("missing")


@pytest.mark.slow
def test_search_gives_the_same_digest_on_a_weaker_machine(tmp_path: Path, whole_search: tuple[Path, str]) -> None:
    """What candidates compute does not depend on the walls around them."""
    done = tacevo("search", *SEARCH, UNTRACKED, cwd=tmp_path, before=WEAKER)
    assert done.stdout.splitlines()[-1] == f"digest: {whole_search[1]}"
