"""Promise: the files of a study are whole or absent, and every edited row is named by network and seed."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ledger_lines import score, study_header
from refusals import refused

from tacevo.config.compose import compose_study
from tacevo.errors import DivergenceError, RunError
from tacevo.results.study_directory import StudyDirectory, misfits, studies_of
from tacevo.storage.ledger import sealed_text

HEADER = study_header()
ROWS = [score(network.name, seed, 0.5 + seed) for network in HEADER.networks for seed in range(2)]
SURROUNDINGS: dict[str, Any] = {"scale": (), "units": (), "versions": {}, "machine": {"cpu": "first"}}


@pytest.fixture
def directory(tmp_path: Path) -> StudyDirectory:
    """Return a finished study."""
    made = StudyDirectory(tmp_path / "run" / "studies" / "mine")
    made.begin(HEADER, **SURROUNDINGS)
    made.finish(HEADER, ROWS)
    return made


def test_description_is_kept_and_digest_comes_last(tmp_path: Path) -> None:
    """Before the end there is no digest and no score; a study that is begun again keeps its circumstances."""
    directory = StudyDirectory(tmp_path / "mine")
    directory.begin(HEADER, **SURROUNDINGS)
    directory.begin(HEADER, **{**SURROUNDINGS, "machine": {"cpu": "second"}})
    assert (directory.read().machine, directory.read().digest) == ({"cpu": "first"}, None)
    assert misfits(directory.read(), HEADER) == []
    assert misfits(directory.read(), replace(HEADER, rules=9)) == ["rules"]
    with refused(RunError, place="mine", got="one that was interrupted") as refusal:
        directory.read_finished()
    command = shlex.split(str(refusal.value.remedy).split("`")[1])
    config = compose_study(["run=RUN", *command[3:]])
    assert (command[1], config.elites, config.seeds) == ("study", len(HEADER.networks) - 1, HEADER.seeds)
    assert config.epochs == HEADER.recipe.epochs
    digest = directory.finish(HEADER, ROWS)
    assert directory.read().digest == digest == directory.read_scores().digest
    assert directory.read_scores().rows == tuple(ROWS)


def test_scores_of_another_study_are_refused(tmp_path: Path) -> None:
    """Each file is sound by itself, but study.json does not have the digest of these scores."""
    ours, other = StudyDirectory(tmp_path / "ours"), StudyDirectory(tmp_path / "other")
    for directory, rows in ((ours, ROWS), (other, ROWS[:-1])):
        directory.begin(HEADER, **SURROUNDINGS)
        directory.finish(HEADER, rows)
    ours.scores.write_bytes(other.scores.read_bytes())
    with refused(RunError, place="ours/study.json", expected="with which scores.jsonl ends"):
        ours.read_finished()


def test_finishing_again_changes_no_byte(directory: StudyDirectory) -> None:
    """A second process that ends the same study finds equal scores."""
    before = {path: path.read_bytes() for path in directory.path.iterdir()}
    directory.finish(HEADER, ROWS)
    assert {path: path.read_bytes() for path in directory.path.iterdir()} == before


def test_other_scores_are_a_difference(directory: StudyDirectory) -> None:
    """Recorded scores are never replaced; the first row and field that differ are named."""
    before = directory.scores.read_bytes()
    others = [*ROWS[:2], replace(ROWS[2], metrics={"mse": 9.0}), ROWS[3]]
    with refused(DivergenceError, place="variant 1, seed 0, metrics.mse", expected="0.5 as recorded", got="9.0"):
        directory.finish(HEADER, others)
    assert directory.scores.read_bytes() == before
    with refused(DivergenceError, place="the study's header, seeds", expected="2 as recorded", got="3"):
        directory.read_scores().compare(replace(HEADER, seeds=3), ROWS)


@pytest.mark.parametrize(
    ("line", "named"),
    [(0, "the header"), (2, "baseline, seed 1"), (3, "variant 1, seed 0")],
)
@pytest.mark.parametrize(("was", "now"), [('"kind"', '"king"'), (":", ": NaN, "), ("{", "["), ('"hash"', '"hush"')])
def test_edited_row_is_named(line: int, named: str, was: str, now: str, directory: StudyDirectory) -> None:
    """Another word, NaN, what is not JSON, and a hash that went missing."""
    lines = directory.scores.read_text().splitlines()
    lines[line] = lines[line].replace(was, now, 1)
    directory.scores.write_text("\n".join(lines) + "\n")
    with refused(RunError, place=f"scores.jsonl, {named}", remedy="writes it again"):
        directory.read_scores()


def test_removed_and_swapped_rows_are_noticed(directory: StudyDirectory) -> None:
    """The chain holds every row in its place; rows cut off at the end change the digest."""
    lines = directory.scores.read_text().splitlines()
    for changed in ([*lines[:2], *lines[3:]], [*lines[:3], lines[4], lines[3]]):
        directory.scores.write_text("\n".join(changed) + "\n")
        with refused(RunError, expected="a line that matches its hash"):
            directory.read_scores()
    directory.scores.write_text("\n".join([*lines, lines[-1]]) + "\n")
    with refused(RunError, place="line 6"):
        directory.read_scores()


@pytest.mark.parametrize("text", ["", "[]\n", "{\n", '{"schema": 99}\n', "[1]\n[2]\n"])
@pytest.mark.parametrize("name", ["study.json", "scores.jsonl"])
def test_damaged_file_is_one_line(name: str, text: str, directory: StudyDirectory) -> None:
    """Whatever stands in it, it is refused by its path, and there is no other exception."""
    (directory.path / name).write_text(text)
    with refused(RunError, place=f"mine/{name}"):
        directory.read_finished()


@pytest.mark.parametrize("lines", [[], [HEADER], ROWS, [HEADER, HEADER, *ROWS]])
def test_scores_need_one_header_and_rows(lines: list[object], directory: StudyDirectory) -> None:
    """However well they are sealed."""
    directory.scores.write_text(sealed_text(lines)[0])
    with refused(RunError, place="scores.jsonl", expected="a header, then scores"):
        directory.read_scores()


def test_studies_of_a_run_are_listed_by_name(directory: StudyDirectory, tmp_path: Path) -> None:
    """Every directory with a study.json, and nothing else."""
    StudyDirectory(tmp_path / "run" / "studies" / "a").begin(HEADER, **SURROUNDINGS)
    (tmp_path / "run" / "studies" / "empty").mkdir()
    assert [study.path.name for study in studies_of(tmp_path / "run")] == ["a", directory.path.name]
    assert studies_of(tmp_path) == []
