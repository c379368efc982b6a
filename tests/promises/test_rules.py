"""Promise: a run that was published outlives the code that made it."""

import json
import shutil
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from smallest import UNTRACKED

from tacevo.cli.app import main
from tacevo.errors import RunError
from tacevo.records import Json
from tacevo.rules import (
    CORES,
    CURRENT,
    FIRST,
    LAST_RELEASES,
    TRAININGS,
    Era,
    Rules,
    by_rules,
    check_known,
    eras_of,
    recorded,
)
from tacevo.storage.store import Store

GOLDEN = Path(__file__).parents[1] / "golden" / "bundles"

#: The first published runs, and the digests that every later release must replay them to.
DIGESTS = {
    "ablation-force-grammar.zip": "9d2feb3bf77c6d69f41ec90af0ba8e768ea6c16361c83d5ebf455df8897ff9cf",
    "force-grammar.zip": "fec21d53ea9151fb2168425ae18faa61850a443b1e7d435470efa28351b2008f",
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


def release(setting: str, *command: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command of another release of the package, which is this one with other numbers."""
    program = f"{setting}\nfrom tacevo.cli.app import main\nsys.exit(main(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, command)], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("name", DIGESTS)
def test_later_release_replays_the_first_published_runs(name: str) -> None:
    """Whichever number of the rules is raised; what it would write otherwise is said, and is no failure."""
    replayed = release(LATER, "replay", GOLDEN / name)
    assert replayed.returncode == 0, replayed.stderr
    assert replayed.stdout.splitlines()[-1] == f"digest: {DIGESTS[name]}"
    assert "summary and tables were written by another release" in replayed.stdout


def test_release_without_the_core_of_a_run_names_the_one_that_has_it(published: Path) -> None:
    """In one line, with the command that gets it."""
    refused = release(WITHOUT_OLD, "replay", published / "run")
    assert refused.returncode == 2
    line = refused.stderr.splitlines()[-1]
    assert f"was made under core rules {CURRENT.core}; this release computes core rules {CURRENT.core + 1};" in line
    assert line.endswith("release 0.1.0 can: git checkout v0.1.0 && make setup")


def test_continuing_under_other_rules_is_said_and_must_be_asked_for(published: Path, tmp_path: Path) -> None:
    """Without `--rules current` nothing is written; with it, the ledger says from where on the new rules hold."""
    longer = tmp_path / "longer"
    command: list[str | Path] = [
        "continue",
        published / "run.zip",
        "search.generations=2",
        f"run.dir={longer}",
        UNTRACKED,
    ]
    command += [f"store.root={tmp_path / 'cache'}"]
    refused = release(LATER, *command)
    assert refused.returncode == 2
    assert f"static {CURRENT.static} instead of {CURRENT.static + 1}" in refused.stderr
    assert "--rules current" in refused.stderr
    assert not longer.exists()

    done = release(LATER, *command, "--rules", "current")
    assert done.returncode == 0, done.stderr
    begun = (published / "run" / "ledger.jsonl").read_bytes()
    lines = (longer / "ledger.jsonl").read_bytes()
    assert lines.startswith(begun)
    (change,) = [line for line in map(json.loads, lines.splitlines()) if line["kind"] == "rules"]
    later = {part: number + 1 for part, number in asdict(CURRENT).items()}
    assert (change["generation"], change["rules"]) == (2, later)
    digest = done.stdout.splitlines()[-1]
    before = f"import sys\nimport tacevo.rules as rules\nrules.CORES |= {{{CURRENT.core + 1}}}"
    for setting in (LATER, before):  # the release that made it, and one with the older policy, probe and trainer
        replayed = release(setting, "replay", longer)
        assert replayed.stdout.splitlines()[-1:] == [digest], replayed.stderr
    assert release(LATER, *command, "--rules", "current").stdout.splitlines()[-1] == digest


def test_probe_that_is_missing_is_not_kept_under_old_rules(published: Path, tmp_path: Path) -> None:
    """A later release that makes one keeps it under its own number."""
    for name in ("run", "cache"):
        shutil.copytree(published / name, tmp_path / name)
    shutil.rmtree(tmp_path / "cache" / "probes")
    made = release(LATER, "tables", tmp_path / "run", "--store", tmp_path / "cache", "-o", tmp_path / "tables")
    assert made.returncode == 0, made.stderr
    kept = [entry.request["version"] for entry in Store(tmp_path / "cache", "probes").entries()]
    assert set(kept) == {CURRENT.probe + 1}


def test_retraining_is_refused_where_the_trainer_cannot(published: Path) -> None:
    """The message names the rules of the run and those that this release has."""
    setting = f"{WITHOUT_OLD}\nrules.CORES |= {{{CURRENT.core}}}"
    refused = release(setting, "replay", published / "run", "--retrain", "1")
    assert refused.returncode == 2
    assert f"was made under training rules {CURRENT.training}; this release computes" in refused.stderr
    assert refused.stderr.endswith("release 0.1.0 can: git checkout v0.1.0 && make setup\n")


def test_what_was_dropped_has_a_release() -> None:
    """A number that this code no longer computes is never left without the release that does."""
    for part, first, known in (("core", FIRST.core, CORES), ("training", FIRST.training, TRAININGS)):
        dropped = set(range(first, max(known))) - known
        assert dropped == {number for of, number in LAST_RELEASES if of == part}


def header(**fields: Json) -> dict[str, Json]:
    """Give the first line of a ledger."""
    return {"kind": "run", **fields}


def test_header_without_rules_means_the_first_ones() -> None:
    """Those of the runs that were published before rules were recorded."""
    assert eras_of([header()]) == (Era(generation=0, rules=FIRST),)
    assert recorded(FIRST) == {}
    assert eras_of([header(**recorded(replace(FIRST, static=9)))])[0].rules == replace(FIRST, static=9)


def test_every_line_has_the_rules_of_its_era() -> None:
    """A line of the new rules begins an era."""
    new = replace(FIRST, probe=9)
    change = Era(generation=2, rules=new).line()
    lines = [header(), {"kind": "generation"}, change, {"kind": "candidate"}]
    assert [rules for rules, _ in by_rules(lines)] == [FIRST, FIRST, new, new]


@pytest.mark.parametrize("generations", [(2, 2), (3, 2), (0,)])
def test_eras_that_do_not_follow_each_other_are_refused(generations: tuple[int, ...]) -> None:
    """A ledger can be edited."""
    lines = [Era(generation=generation, rules=FIRST).line() for generation in generations]
    with pytest.raises(ValueError, match="expected eras that begin one after the other"):
        eras_of([header(), *lines])


@pytest.mark.parametrize("value", [{}, {"static": 1}, {**asdict(FIRST), "core": "1"}, {**asdict(FIRST), "more": 1}])
def test_rules_that_nobody_writes_are_refused(value: Json) -> None:
    """A ledger can be edited."""
    with pytest.raises(ValueError, match="expected rules with an integer for each of"):
        Rules.from_json(value)


def test_rules_of_a_later_release_ask_for_an_update() -> None:
    """No release is known that has them."""
    check_known("core", CURRENT.core, CORES, "run")
    with pytest.raises(RunError, match=r"run was made under core rules 99; .* a later release made it: update tacevo"):
        check_known("core", 99, CORES, "run")


def test_run_says_which_rules_made_it(published: Path) -> None:
    """In the first line of its ledger, unless they are the first rules; they count for the digest."""
    first = json.loads((published / "run" / "ledger.jsonl").read_text().splitlines()[0])
    assert eras_of([first])[0].rules == CURRENT
    assert main(["replay", str(published / "run")]) == 0
