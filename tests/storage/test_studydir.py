"""Promise: the files of a study are whole or absent, and every edited row is named by network and seed."""

import json
from pathlib import Path

import pytest

from tacevo.errors import DivergenceError, RunError
from tacevo.records import Json
from tacevo.storage.study_directory import StudyDirectory, describes, studies_of

HEADER: dict[str, Json] = {"kind": "study", "networks": [{"name": "baseline"}, {"name": "variant 1"}], "seeds": 2}
ENTRIES: list[dict[str, Json]] = [
    HEADER,
    *(
        {"kind": "score", "network": network["name"], "seed": seed, "metrics": {"mse": 0.5 + seed}}
        for network in HEADER["networks"]
        for seed in range(2)
    ),
]


@pytest.fixture
def directory(tmp_path: Path) -> StudyDirectory:
    """Give a finished study."""
    made = StudyDirectory(tmp_path / "run" / "studies" / "mine")
    made.begin({"run": "r"}, {"machine": {}})
    made.finish(ENTRIES)
    return made


def test_description_is_kept_and_digest_comes_last(tmp_path: Path) -> None:
    """Before the end there is no digest and no score; a study that is begun again keeps its circumstances."""
    directory = StudyDirectory(tmp_path / "mine")
    directory.begin({"run": "r"}, {"machine": "first"})
    directory.begin({"run": "r"}, {"machine": "second"})
    assert (directory.read()["machine"], directory.read()["digest"]) == ("first", None)
    with pytest.raises(RunError, match=r"mine is not finished: it has no scores.jsonl; `tacevo study` continues it"):
        directory.read_scores()
    digest = directory.finish(ENTRIES)
    assert directory.read()["digest"] == digest == directory.read_scores()[-1]["hash"]


def test_finishing_again_changes_no_byte(directory: StudyDirectory) -> None:
    """A second process that ends the same study finds equal scores."""
    before = {path: path.read_bytes() for path in directory.path.iterdir()}
    directory.finish(ENTRIES)
    assert {path: path.read_bytes() for path in directory.path.iterdir()} == before


def test_other_scores_are_a_difference(directory: StudyDirectory) -> None:
    """Recorded scores are never replaced; the first row and field that differ are named."""
    before = directory.scores.read_bytes()
    others = [*ENTRIES[:3], {**ENTRIES[3], "metrics": {"mse": 9.0}}, ENTRIES[4]]
    with pytest.raises(
        DivergenceError, match=r"variant 1, seed 0: field 'metrics.mse' was recorded as 0.5 and is now 9"
    ):
        directory.finish(others)
    assert directory.scores.read_bytes() == before
    with pytest.raises(DivergenceError, match=r"the study's header: field 'seeds' was recorded as 2 and is now 3"):
        directory.compare([{**HEADER, "seeds": 3}])


@pytest.mark.parametrize(
    ("line", "named"),
    [(0, "the header"), (1, "baseline, seed 0"), (2, "baseline, seed 1"), (3, "variant 1, seed 0")],
)
@pytest.mark.parametrize(("was", "now"), [('"kind"', '"king"'), (":", ": NaN, "), ("{", "["), ('"hash"', '"hush"')])
def test_edited_row_is_named(line: int, named: str, was: str, now: str, directory: StudyDirectory) -> None:
    """Another word, NaN, what is no JSON, and a hash that went missing."""
    lines = directory.scores.read_text().splitlines()
    lines[line] = lines[line].replace(was, now, 1)
    directory.scores.write_text("\n".join(lines) + "\n")
    with pytest.raises(RunError, match=rf"scores.jsonl, {named}: the line does not match its hash.*writes it anew"):
        directory.read_scores()


def test_removed_and_swapped_rows_are_noticed(directory: StudyDirectory) -> None:
    """The chain holds every row in its place; rows cut off at the end change the digest."""
    lines = directory.scores.read_text().splitlines()
    for changed in ([*lines[:2], *lines[3:]], [*lines[:3], lines[4], lines[3]]):
        directory.scores.write_text("\n".join(changed) + "\n")
        with pytest.raises(RunError, match="does not match its hash"):
            directory.read_scores()
    directory.scores.write_text("\n".join([*lines, lines[-1]]) + "\n")
    with pytest.raises(RunError, match="line 6: the line does not match its hash"):
        directory.read_scores()


def test_damaged_description_is_one_line(directory: StudyDirectory) -> None:
    """What is no study.json, or one of another layout, is refused by its folder."""
    path = directory.path / "study.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema": 99}))
    with pytest.raises(RunError, match=r"study.json has schema 99; this version reads 2\. Delete .*writes it anew"):
        directory.read()
    for text in ("", "[]", "{"):
        path.write_text(text)
        with pytest.raises(RunError, match=r"mine is not the folder of a study: it has no sound study.json"):
            directory.read()


@pytest.mark.parametrize("text", ["", "\n", "{}", "[1]\n[2]\n"])
def test_file_without_scores_is_one_line(text: str, directory: StudyDirectory) -> None:
    """Whatever stands in it, there is no other exception."""
    directory.scores.write_text(text)
    with pytest.raises(RunError, match=r"is not finished|the header: the line does not match its hash"):
        directory.read_scores()


def test_scores_of_another_kind_are_one_line(directory: StudyDirectory) -> None:
    """A sealed header that lists no networks does not help to name a broken row, and does no harm."""
    directory.scores.unlink()
    directory.finish([{"kind": "run"}, *ENTRIES[1:]])
    directory.scores.write_text(directory.scores.read_text().replace("0.5", "0.6"))
    with pytest.raises(RunError, match="line 2: the line does not match its hash"):
        directory.read_scores()


def test_studies_of_a_run_are_listed_by_name(directory: StudyDirectory, tmp_path: Path) -> None:
    """Every folder with a study.json, and nothing else."""
    StudyDirectory(tmp_path / "run" / "studies" / "a").begin({"run": "r"}, {})
    (tmp_path / "run" / "studies" / "empty").mkdir()
    assert [study.path.name for study in studies_of(tmp_path / "run")] == ["a", directory.path.name]
    assert studies_of(tmp_path) == []


def test_description_must_be_whole() -> None:
    """One other or missing value makes another study."""
    assert describes({"a": 1, "b": 2}, {"a": 1})
    assert not describes({"a": 1}, {"a": 1, "b": 2})
    assert not describes({"a": 2}, {"a": 1})
    assert not describes(None, {})
