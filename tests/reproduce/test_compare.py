"""Promise: two runs are called equal only where their ledgers are, and else the first difference is named.

Whatever stands in a run's files, `tacevo replay --diff` meets it with one line, and never a traceback.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bundles import with_line
from hand_runs import configured, of_lines
from ledger_lines import ended, header, rejected, run_record, trained

from tacevo.choices import ArchiveKind
from tacevo.cli.app import main
from tacevo.evolution.run_files import Line, RunLine
from tacevo.records import Json
from tacevo.reproduce.compare import compare
from tacevo.results.run import RecordedRun

#: It has a source, and no fitness.
FAILED = rejected("g01s03", "train", "out_of_time", source="source 03")

CANDIDATES = (trained("g01s00", 0.1), trained("g01s01", 0.2), trained("g01s02", 0.3), FAILED)

SETTINGS: dict[str, Any] = {"seed": 0, "archive": {}}


def recorded(*lines: Line, first: RunLine | None = None, elites: Mapping[str, int] | None = None) -> RecordedRun:
    """Make a finished run, with its elites by niche."""
    places = {"g01s00": 0, "g01s01": 4} if elites is None else elites
    return of_lines(first or header(), *lines, elites=places, record=run_record(config=SETTINGS))


RUN = recorded(*CANDIDATES, ended(1, best=0.1))

LONGER = recorded(*CANDIDATES, ended(1, best=0.1), ended(2, best=0.05))

#: By hand: the second source is 0.1 apart and the third 0.3, and neither hides the difference before it.
OTHER = recorded(CANDIDATES[0], trained("g01s01", 0.3), trained("g01s02", 0.6), CANDIDATES[3], ended(1, best=0.1))


def with_settings(**groups: Json) -> RecordedRun:
    """Return the run with further settings."""
    return replace(RUN, record=run_record(config={**SETTINGS, **groups}))


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        (RUN, RUN, "the ledgers are equal: 6 lines"),
        (RUN, OTHER, "equal: the first 2 lines, of 6 and 6"),
        (
            RUN,
            OTHER,
            "first difference: generation 1, slot 1: field 'fitness' is 0.2 in the first run and 0.3 in the second",
        ),
        (RUN, LONGER, "the second run goes on where the other ends"),
        (LONGER, RUN, "the first run goes on where the other ends"),
        (RUN, LONGER, "best: 0.1 and 0.05"),
        (
            RUN,
            recorded(CANDIDATES[0], trained("g01s01", 0.3), *RUN.ledger.lines[3:], first=header(config={"seed": 1})),
            "first difference behind the header: generation 1, slot 1: field 'fitness' is 0.2 in the first run and "
            "0.3 in the second",
        ),
        (
            RUN,
            OTHER,
            "3 sources trained in both: 1 with the same fitness; differences up to 0.3, median 0.1",
        ),
        (
            RUN,
            recorded(trained("g01s07", 0.1), *CANDIDATES[3:], ended(1), elites={}),
            "no source was trained in both runs",
        ),
        (
            RUN,
            recorded(*RUN.ledger.lines[1:], elites={"g01s00": 0, "g01s02": 4, "g01s01": 5}),
            "elites: 2 and 3; 2 sources are elites of both; 2 niches are filled in both, 1 of them by one source",
        ),
    ],
)
def test_what_two_runs_share_and_where_they_part_is_said(one: RecordedRun, other: RecordedRun, said: str) -> None:
    """Only equal ledgers are called equal; a rejected candidate has no fitness to compare."""
    is_equal, text = compare(one, other)
    assert said in text.splitlines()
    assert is_equal == (one.ledger.lines == other.ledger.lines)


def test_settings_that_differ_are_listed_but_not_where_the_runs_lie() -> None:
    """A directory's name is not a difference between runs."""
    one = with_settings(llm={"model": "a"}, run={"dir": "x"}, store={"root": "y"})
    other = with_settings(llm={"model": "b"}, run={"dir": "z"}, store={"root": "w"})
    is_equal, text = compare(one, other)
    assert is_equal
    assert [line for line in text.splitlines() if line.startswith("setting ")] == ['setting llm.model: "a" and "b"']


@pytest.mark.parametrize(
    "other",
    [
        recorded(*RUN.ledger.lines[1:], first=header(centroids="d")),
        replace(RUN, config=configured(archive={"kind": ArchiveKind.best})),
    ],
)
def test_places_that_mean_something_else_are_not_compared(other: RecordedRun) -> None:
    """Niche 4 of one tessellation is not niche 4 of another, nor the fourth best network; sources still count."""
    for pair in ((RUN, other), (other, RUN)):
        assert "2 sources are elites of both; niches are not compared" in compare(*pair)[1]


def refused(run: Path, published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """See that the comparison ends in one line."""
    assert main(["replay", str(run), "--diff", str(published / "run")]) == 2
    _, said = capsys.readouterr().err.splitlines()
    assert said.startswith("error: ")


@pytest.mark.parametrize("name", ["ledger.jsonl", "run.json", "archive.json"])
@pytest.mark.parametrize("content", [b"[" * 100_000, b"[]", b"null", b"\xff", b'{"a": NaN}'])
def test_file_of_nonsense_is_an_error(
    name: str, content: bytes, run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nesting that no parser follows among it."""
    (run / name).write_bytes(content + b"\n")
    refused(run, published, capsys)


@pytest.mark.parametrize(
    "edit",
    [
        lambda line: line.update(fitness="low"),
        lambda line: line.update(fitness=10**400),
        lambda line: line.pop("kind"),
    ],
)
def test_sealed_nonsense_is_an_error(
    edit: Callable[[dict[str, Json]], object], run: Path, published: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line may say anything under a hash that fits it."""
    members = {f"run/{name}": (run / name).read_bytes() for name in ("ledger.jsonl", "run.json")}
    for name, data in with_line(members, 1, edit).items():
        (run / name.removeprefix("run/")).write_bytes(data)
    refused(run, published, capsys)


def test_deep_settings_are_an_error(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As deep as a parser still follows, and a comparison does not."""
    shutil.copytree(run, tmp_path / "other" / "run")
    for folder, end in ((run, "1"), (tmp_path / "other" / "run", "2")):
        told = (folder / "run.json").read_text()
        deep = told.replace('"seed": 0', f'"seed": {"[" * 900}{end}{"]" * 900}', 1)
        assert deep != told
        (folder / "run.json").write_text(deep)
    refused(run, tmp_path / "other", capsys)
