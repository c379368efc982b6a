"""Promise: a search, a study and a publication from Python are those of the commands, from any program."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from checkout import ROOT
from pandas.testing import assert_frame_equal
from refusals import refused
from smallest import PUBLISHED_SIZES, SMALLEST, UNTRACKED

import tacevo
from tacevo.cli.app import main

SMALL = [*SMALLEST, *PUBLISHED_SIZES, UNTRACKED]

#: Settings of the runs that given networks stand in: gratings in 40 images.
GIVEN = ["data.images=70", "data.image_size=32", UNTRACKED]

#: A program without `if __name__ == "__main__"`, whose images are made by several processes.
SCRIPT = """
import sys
import tacevo

print([tacevo.search(*sys.argv[1:], "run.dir=run", quiet=True).digest])
"""


@pytest.mark.room("publishing", "plans, pilots")
@pytest.mark.slow
def test_whole_way_from_a_search_to_a_bundle(place: Path) -> None:
    """Each call returns what the commands then find, and a second search in the process is the command's."""
    run = tacevo.search(*SMALL, "run.dir=run", quiet=True)
    assert main(["search", *SMALL, "run.dir=other"]) == 0
    other = tacevo.open("other")
    assert isinstance(other, tacevo.Run)
    assert run.digest == other.digest == tacevo.search(*SMALL, "run.dir=run", quiet=True).digest
    noise = tacevo.noise(run, elites=1, seeds=2, quiet=True)
    assert noise.is_noise
    assert [*noise.reestimates["seed"]] == [0, 1, 0, 1]
    with refused(tacevo.RunError, place=noise.name, got="a noise run"):
        tacevo.plan("study", noise, effect=0.2)
    before = [one.name for one in run.studies]
    study = tacevo.study(run, elites=1, seeds=4, epochs=1, quiet=True)
    assert [one.name for one in run.studies] == sorted([*before, study.name])  # an open run sees what was made
    assert [*study.verdicts.index] == ["variant 1"]
    assert len(study.scores) == 8
    digest = tacevo.publish(run, "mine.zip", authors=["A. Nyone"], quiet=True)
    assert len(digest) == 64
    again = tacevo.open("mine.zip")
    assert isinstance(again, tacevo.Run)
    assert again.replay(quiet=True) == run.digest
    assert_frame_equal(next(one for one in again.studies if not one.is_noise).verdicts, study.verdicts)
    with refused(tacevo.ConfigError, expected="a run in a directory"):
        tacevo.study(again, elites=1)
    with refused(tacevo.ConfigError, got="data.split_seed=1,2", remedy="call it for each"):
        tacevo.study(run, "data.split_seed=1,2", elites=1)
    Path("notes.txt").write_text("mine")
    with refused(tacevo.ConfigError, place="notes.txt", expected="no file, or a bundle"):
        tacevo.publish(run, "notes.txt", quiet=True)
    assert Path("notes.txt").read_text() == "mine"


@pytest.mark.slow
def test_given_networks_are_studied_without_a_run(place: Path) -> None:
    """As by `tacevo study networks=`, and a baseline alone."""
    recipe: dict[str, Any] = {"task": "grating", "seeds": 2, "epochs": 1, "quiet": True}
    study = tacevo.study(None, *GIVEN, networks=str(ROOT / "conf" / "library" / "grating" / "by_hand.py"), **recipe)
    assert [*study.networks.index] == ["baseline", "by_hand"]
    alone = tacevo.study(None, *GIVEN, **recipe)
    assert [*alone.networks.index] == ["baseline"]


@pytest.mark.slow
def test_program_without_a_main_guard_searches_once(place: Path) -> None:
    """Processes that make images do not run the program again."""
    (place / "program.py").write_text(SCRIPT)
    many = [*SMALL, "search.generations=0", "search.initial=1", "data.images=260", "executor.workers=2"]
    done = subprocess.run([sys.executable, "program.py", *many], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("[") == 1


@pytest.mark.slow  # the same interruption of the command is tried in tests/cli/test_cli.py
def test_interrupted_search_is_continued(place: Path) -> None:
    """As by a notebook's stop button; the same call then gives the digest of one that was never stopped."""
    (place / "program.py").write_text(
        "import sys, tacevo\nprint(tacevo.search(*sys.argv[1:], 'run.dir=run', quiet=True).digest)\n"
    )
    words = SMALL
    process = subprocess.Popen([sys.executable, "program.py", *words], stderr=subprocess.PIPE, text=True)
    ledger = place / "run" / "ledger.jsonl"
    while process.poll() is None and not (ledger.exists() and ledger.read_text().count("\n") > 2):
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGINT)
    error = process.communicate()[1]
    assert process.returncode == 0 or "KeyboardInterrupt" in error
    run = tacevo.search(*words, "run.dir=run", quiet=True)
    assert run.digest == tacevo.search(*words, "run.dir=whole", quiet=True).digest


@pytest.mark.parametrize(("words", "place"), [(["seed=0,1"], ""), (["seed=1"], "experiment")])
def test_what_is_not_one_search_is_refused(words: list[str], place: str) -> None:
    """A sweep; and one whose size nobody has chosen."""
    with refused(tacevo.ConfigError, place=place, expected="one "):
        tacevo.search(*words)


@pytest.mark.parametrize("settings", [{"elites": 0}, {"seeds": "many"}, {"serach": 1}, {"elites": None}])
def test_wrong_setting_is_refused_before_anything_is_trained(run: Path, settings: dict[str, object]) -> None:
    """As by the command."""
    with pytest.raises(tacevo.ConfigError):
        tacevo.study("run", quiet=True, **settings)
    assert len([*(run / "studies").iterdir()]) == 1
