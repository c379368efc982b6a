"""Promise: a finished run is one whose ledger, digest and archives agree."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fakes
import pytest
from ledger_lines import candidate, run_record
from refusals import refused

from tacevo.errors import RunError
from tacevo.evolution.algorithm import run_search
from tacevo.evolution.lines import CandidateLine, GenerationLine
from tacevo.evolution.run_files import (
    check_references,
    finished_digest,
    line_kind,
    read_archives,
    read_elites,
    read_finished,
    read_ledger,
    write_archives,
)
from tacevo.records import Operator
from tacevo.runs.search_files import archive_files
from tacevo.storage.ledger import Ledger
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture
def directory(tmp_path: Path) -> RunDirectory:
    """Make the files of a small search."""
    made, plan = RunDirectory(tmp_path), fakes.plan(generations=2)
    with Ledger.open(made.ledger, line_kind) as ledger:
        state = run_search(plan, fakes.effects(), ledger, fakes.Recorder())
    write_archives(made, archive_files(plan, state))
    made.write_run(run_record(digest=ledger.digest))
    return made


def last(directory: RunDirectory) -> GenerationLine:
    """Return the line that ends the ledger."""
    line = read_ledger(directory).lines[-1]
    assert isinstance(line, GenerationLine)
    return line


def test_run_is_finished_where_the_digest_is_the_last_hash(directory: RunDirectory) -> None:
    """Not without one, and not with another one."""
    record, ledger = read_finished(directory)
    assert record.digest == ledger.digest == finished_digest(directory)
    for digest in (None, "0" * 64):
        directory.write_run(replace(record, digest=digest))
        assert finished_digest(directory) is None
        with refused(RunError, place=str(directory.path), expected="a finished run", got="not finished"):
            read_finished(directory)


def test_archives_are_those_of_the_ledger(directory: RunDirectory, tmp_path: Path) -> None:
    """Each file names the occupants that the last generation has the hash of; a run that was not begun has none."""
    networks, prompts = read_archives(directory, last(directory))
    assert networks.elites == read_elites(directory) != ()
    assert prompts.trials
    elsewhere = RunDirectory(tmp_path / "elsewhere")
    assert (finished_digest(elsewhere), read_elites(elsewhere)) == (None, ())


EDITS: list[tuple[str, Callable[[Any], object]]] = [
    ("archive.json", lambda file: file["elites"].pop()),
    ("archive.json", lambda file: file["elites"].append(file["elites"][0])),
    ("archive.json", lambda file: file["elites"][0].update(fitness=0.0)),
    ("archive.json", lambda file: file["elites"][0].update(id="g09s09")),
    ("archive.json", lambda file: file["elites"][0].update(niche=99)),
    ("archive.json", lambda file: file["elites"].insert(0, {**file["elites"][0], "fitness": 1e-9})),
    ("archive.json", lambda file: file.update(bounds=None)),
    ("archive.json", lambda file: file["bounds"].update(low=[-9.0, -9.0])),
    ("prompts.json", lambda file: file["trials"].pop()),
    ("prompts.json", lambda file: file["trials"][0].update(curiosity=9.0)),
    ("prompts.json", lambda file: file["trials"][0].update(prompt=999)),
]


@pytest.mark.parametrize(("name", "edit"), EDITS)
def test_edited_archive_is_refused(name: str, edit: Callable[[Any], object], directory: RunDirectory) -> None:
    """Whatever was changed, the message names the file and what writes it again."""
    path = directory.path / name
    file = json.loads(path.read_text())
    edit(file)
    path.write_text(json.dumps(file))
    with refused(RunError, place=name, remedy="the command that began the run writes it again"):
        read_archives(directory, last(directory))


@pytest.mark.parametrize("text", [None, "", "{"])
@pytest.mark.parametrize("name", ["archive.json", "prompts.json"])
def test_archive_that_is_not_json_is_refused(name: str, text: str | None, directory: RunDirectory) -> None:
    """Also where it is missing."""
    (directory.path / name).unlink()
    if text is not None:
        (directory.path / name).write_text(text)
    with refused(RunError, place=name):
        read_archives(directory, last(directory))


@pytest.mark.parametrize(
    "lines",
    [
        [candidate("g00s00", operator=Operator.baseline), candidate("g01s00", parents=("zzz",))],
        [candidate("g00s00", operator=Operator.baseline), candidate("g01s00", prompt=999)],
        [candidate("g01s00")],
        [candidate("g00s00", operator=Operator.baseline), candidate("g01s00", id="../../x")],
        [candidate("g00s00", operator=Operator.baseline), candidate("g00s01", operator=Operator.given, prompt=None)],
    ],
)
def test_candidates_name_what_there_is(lines: list[CandidateLine]) -> None:
    """A ledger sealed again with an unknown parent, instruction or network, no baseline, or a path as id is refused."""
    with refused(RunError, place="run", expected="candidates that name earlier ones"):
        check_references(Path("run"), run_record(), lines)


@pytest.mark.parametrize(
    ("line", "setting"),
    [({"kind": "reevaluation"}, "archive.kind=extract"), ({"kind": "candidate", "seeds": [{}]}, "training.seeds")],
)
def test_line_of_a_removed_setting_is_refused_by_its_name(
    line: dict[str, Any], setting: str, directory: RunDirectory
) -> None:
    """In a ledger of an earlier release, with what does so now."""
    again = {**line, "generation": 1, "slot": 2, "id": "g00s00", "previous": "0", "hash": "0"}
    directory.ledger.write_text(f"{directory.ledger.read_text()}{json.dumps(again)}\n")
    with refused(RunError, place="ledger.jsonl, line", got=setting, remedy="tacevo noise"):
        read_ledger(directory)


@pytest.mark.parametrize("far", [10**9, -1, 0])
def test_generations_are_counted(far: int, directory: RunDirectory) -> None:
    """Readers loop over them, so a line of a far generation would take for ever."""
    record, ledger = read_finished(directory)
    check_references(Path("run"), record, ledger.lines)
    lines = [*ledger.lines[:-1], replace(last(directory), generation=far)]
    with refused(RunError, place="run", expected="one of generation 2"):
        check_references(Path("run"), record, lines)
