"""Promise: a run that was published outlives the code that made it."""

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from checkout import BUNDLES
from commands import tacevo
from ledger_lines import candidate, header
from refusals import refused
from smallest import UNTRACKED

from tacevo.errors import RunError
from tacevo.evolution.run_files import Line, RunLine, read_ledger, rules_of
from tacevo.records import written
from tacevo.rules import CORES, CURRENT, FIRST, LAST_RELEASES, TRAININGS, check_known
from tacevo.storage.run_directory import RunDirectory
from tacevo.storage.store import Store
from tacevo.typed import convert

#: The first published runs, and the digests that every later release must replay them to; nobody may exchange them.
DIGESTS = {
    "ablation-force-grammar.zip": "9d2feb3bf77c6d69f41ec90af0ba8e768ea6c16361c83d5ebf455df8897ff9cf",
    "ablation-grating.zip": "7624ebab3f68e92b0df3427bdac19d5b785cad3248670e26f852e3954944af39",
    "force-grammar.zip": "fec21d53ea9151fb2168425ae18faa61850a443b1e7d435470efa28351b2008f",
    "grating-by-hand-48.zip": "718f34c9e0501e67f3f819f22bb4774c6efc7325bd09b4ea2cf8050c0232ce6e",
    "grating-chosen-48.zip": "53d9b7e6f5d58d3263c87b006db7751a5833e72cec1756c1f59dfd2bafea1e57",
    "grating-grammar.zip": "ffc6a36ea7658b4ed3488212eb75fbd9222f6e05c3bc8ef320af9a20849ae00d",
}

#: A later release: every number is raised, and the code that kept the old core is still there.
LATER = """
import sys
from dataclasses import asdict
import tacevo.rules as rules
rules.CURRENT = rules.Rules(**{part: number + 1 for part, number in asdict(rules.CURRENT).items()})
rules.CORES |= {rules.CURRENT.core}
rules.STUDY += 1
rules.PAGES += 1
"""

#: A later release that no longer has the old core and the old trainer.
WITHOUT_OLD = f"""{LATER}
rules.CORES = frozenset([rules.CURRENT.core])
rules.TRAININGS = frozenset([rules.CURRENT.training])
rules.LAST_RELEASES = {{("core", {CURRENT.core}): "0.1.0", ("training", {CURRENT.training}): "0.1.0"}}
"""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name.startswith("force") else pytest.mark.slow) for name in DIGESTS]
)
def test_later_release_replays_the_first_published_runs(name: str) -> None:
    """Whichever number of the rules is raised; what it would write otherwise is said, and is not a failure."""
    replayed = tacevo("replay", BUNDLES / name, before=LATER)
    assert replayed.stdout.splitlines()[-1] == f"digest: {DIGESTS[name]}"
    assert "that another release wrote" in replayed.stdout


@pytest.mark.slow
def test_release_without_the_core_of_a_run_names_the_one_that_has_it(published: Path) -> None:
    """In one line, with the command that gets it."""
    done = tacevo("replay", published / "run", before=WITHOUT_OLD, status=2)
    line = done.stderr.splitlines()[-1]
    assert f"expected core rules {CURRENT.core + 1}; got {CURRENT.core};" in line
    assert line.endswith("git checkout v0.1.0 && make setup")


def continuing(published: Path, folder: Path) -> list[str | Path]:
    """Write the command that continues the run in a directory."""
    where = [f"run.dir={folder / 'longer'}", f"store.root={folder / 'cache'}"]
    return ["extend", published / "run.zip", "search.generations=2", UNTRACKED, *where]


@pytest.mark.slow
def test_continuing_under_other_rules_is_refused(published: Path, tmp_path: Path) -> None:
    """Candidates and new ones would be judged differently; nothing is written."""
    done = tacevo(*continuing(published, tmp_path), before=LATER, status=2)
    assert f"static {CURRENT.static} instead of {CURRENT.static + 1}" in done.stderr
    assert not (tmp_path / "longer").exists()


@pytest.mark.slow
def test_probe_that_is_missing_is_not_made_by_a_later_release(published: Path, tmp_path: Path) -> None:
    """Its tables say what they leave out, and its store keeps nothing under old rules."""
    for name in ("run", "cache"):
        shutil.copytree(published / name, tmp_path / name)
    shutil.rmtree(tmp_path / "cache" / "probes")
    command: list[str | Path] = ["tables", tmp_path / "run", "--store", tmp_path / "cache", "-o", tmp_path / "tables"]
    assert "motifs" in tacevo(*command, before=LATER).stderr
    assert not list(Store(tmp_path / "cache", "probes").entries())


@pytest.mark.slow
def test_retraining_is_refused_where_the_trainer_cannot(published: Path) -> None:
    """The message names the rules of the run and those that this release has."""
    setting = f"{WITHOUT_OLD}\nrules.CORES |= {{{CURRENT.core}}}"
    done = tacevo("replay", published / "run", "--retrain", "1", before=setting, status=2)
    assert f"expected training rules {CURRENT.training + 1}; got {CURRENT.training};" in done.stderr
    assert done.stderr.endswith("git checkout v0.1.0 && make setup\n")


def test_what_was_dropped_has_a_release() -> None:
    """A number that this code no longer computes is never left without the release that does."""
    for part, first, known in (("core", FIRST.core, CORES), ("training", FIRST.training, TRAININGS)):
        dropped = set(range(first, max(known))) - known
        assert dropped == {number for of, number in LAST_RELEASES if of == part}


def test_run_says_which_rules_made_it(published: Path) -> None:
    """In the first line of its ledger; without them they are the first, as of runs published before."""
    assert "rules" not in written(header())
    assert rules_of([header()]) == FIRST
    assert rules_of(read_ledger(RunDirectory(published / "run")).lines) == CURRENT


@pytest.mark.parametrize("lines", [[], [candidate("g00s00"), header()], [header(), candidate("g00s00"), header()]])
def test_ledger_has_one_header(lines: list[Line]) -> None:
    """A ledger can be edited."""
    with refused(RunError, place="ledger.jsonl", expected="one header, in the first line"):
        rules_of(lines)


@pytest.mark.parametrize("value", [{}, {"static": 1}, {**asdict(FIRST), "core": "1"}, {**asdict(FIRST), "more": 1}])
def test_rules_that_no_release_writes_are_refused(value: Any) -> None:
    """A ledger can be edited."""
    with refused(RunError, place="rules"):
        convert(RunLine, {**written(header()), "rules": value}, place="line 1", error=RunError)


def test_rules_of_a_later_release_ask_for_an_update() -> None:
    """No release is known that has them."""
    check_known("core", CURRENT.core, CORES, "run")
    with refused(RunError, place="run", expected="core rules", got="99", remedy="a later release made it"):
        check_known("core", 99, CORES, "run")
