"""The dynamics of a real search agree with what the search itself counted."""

import re
from pathlib import Path

import pytest

from analysis.runs.dynamics import by_prompt, progress
from analysis.tables.dynamics import gate_table
from tacevo.evolution.lines import gate_stages
from tacevo.records import Stage
from tacevo.results.run import RecordedRun, read_run


@pytest.fixture
def run(whole_search: tuple[Path, str]) -> RecordedRun:
    """Return a finished search, some of whose candidates were rejected."""
    return read_run(whole_search[0] / "run")


@pytest.mark.slow
def test_first_answers_are_counted_as_the_search_did(run: RecordedRun) -> None:
    """What all stages leave is what the generations call trained, less the baseline, and some was lost at first."""
    left = gate_stages(run.candidates)[-1].left
    assert left == sum(line.trained for line in run.generations) - 1 < len(run.candidates) - 1
    frame = progress(run)
    assert (frame.trained == frame.candidates - frame[[f"rejected_{stage}" for stage in Stage]].sum(axis=1)).all()


@pytest.mark.slow
def test_summary_and_gate_table_count_alike(run: RecordedRun) -> None:
    """What each stage rejected, as summary.md and the table of the gate have it."""
    page = (run.path / "summary.md").read_text(encoding="utf-8")
    (told,) = re.findall(r"^Gate: .+; rejected: (.+)\.$", page, re.MULTILINE)
    rejected = (f"{stage} {count}" for stage, count, *_ in gate_table(run).rows if count)
    assert re.sub(r" \(.+?\)", "", told) == ", ".join(rejected)


def test_elites_follow_from_the_growth(run: RecordedRun) -> None:
    """The archive ends with as many elites as its generations brought."""
    frame = progress(run)
    assert frame.growth.sum() == frame.elites.iloc[-1] == len(run.elites)


def test_prompts_were_tried_once_a_mutation(run: RecordedRun) -> None:
    """Every mutation of generation 1 was asked with one instruction; each inserted child belongs to one."""
    later = [it for it in run.candidates if it.generation > 0 and it.prompt is not None]
    assert by_prompt(run).tried.sum() == len(later) > 0
    inserted = sum(line.inserted for line in later)
    assert by_prompt(run).inserted.sum() == inserted
