"""The dynamics of a real search agree with what the search itself counted, also where answers were repaired."""

from pathlib import Path

import pytest
from smallest import SMALLEST, UNTRACKED

from analysis.runs.dynamics import by_prompt, gate_stages, progress
from analysis.runs.run import Run, load_run
from analysis.tables.dynamics import gate_table
from tacevo.cli.app import main
from tacevo.records import Stage
from tacevo.search.files import read_ledger
from tacevo.search.lines import CandidateLine
from tacevo.storage.run_directory import RunDirectory


@pytest.fixture(scope="module")
def repaired(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Give a finished search, as small as one can be, whose model often slips and is asked again."""
    folder = tmp_path_factory.mktemp("repaired")
    size = ["search.generations=1", "search.candidates=6", "search.initial=2", "run.dir=run"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        slips = ["llm.slip_rate=0.7", "proposals.repair_attempts=2"]
        assert main(["search", *SMALLEST, UNTRACKED, *size, *slips]) == 0
        return load_run(Path("run").resolve())


def test_first_answers_are_counted_as_the_search_did(repaired: Run) -> None:
    """What all stages leave is what the generations call trained, less the baseline, and some was lost at first."""
    left = gate_stages(repaired)[-1].left
    assert left == sum(line.trained for line in repaired.generations) - 1 < len(repaired.candidates) - 1
    for entry in progress(repaired):
        assert entry.line.trained == entry.line.candidates - sum(entry.rejected.values())


def test_summary_and_gate_table_count_alike(repaired: Run) -> None:
    """Rejected and left, stage by stage, as summary.md and the table of the gate have them."""
    page = (repaired.path / "summary.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:4]] for line in page.splitlines()]
    stages = [row for row in rows if row[:1] and row[0] in set(Stage)]
    assert stages == [[str(cell) for cell in row[:3]] for row in gate_table(repaired).rows]


def test_answers_that_were_sent_back_are_known(repaired: Run) -> None:
    """Each with its stage and reason, as the ledger has them; without any, this test would show nothing."""
    ledger = read_ledger(RunDirectory(repaired.path))
    lines = {line.id: line for line in ledger.lines if isinstance(line, CandidateLine)}
    assert any(candidate.sent_back for candidate in repaired.candidates)
    for candidate in repaired.candidates:
        assert list(candidate.sent_back) == [(sent.stage, sent.reason) for sent in lines[candidate.id].repairs]


def test_elites_follow_from_the_growth(repaired: Run) -> None:
    """The archive ends with as many elites as its generations brought."""
    found = progress(repaired)
    assert sum(entry.growth for entry in found) == found[-1].elites == len(repaired.elites)


def test_prompts_were_tried_once_a_mutation(repaired: Run) -> None:
    """Every mutation of generation 1 was asked with one instruction; each inserted child belongs to one."""
    later = [it for it in repaired.candidates if it.generation > 0 and it.prompt is not None]
    assert sum(entry.tried for entry in by_prompt(repaired)) == len(later) > 0
    inserted = sum(it.trained is not None and it.trained.inserted for it in later)
    assert sum(entry.inserted for entry in by_prompt(repaired)) == inserted
