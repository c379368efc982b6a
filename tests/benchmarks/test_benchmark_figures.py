"""Promise: a figure's ratio says how many times better ours is; benchmarks/README.md holds the measured table."""

import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest
from checkout import ROOT

from benchmarks.__main__ import BENCHMARKS, RESULTS
from benchmarks.record import BEGIN, END, record, table, with_table, write
from benchmarks.timing import Figure, descendants_seconds, medians, report

pytestmark = pytest.mark.room("hosted", "mlflow", "grammar", "table")

LONELY = Figure(title="memory", name="ours", value=12.0, unit="MB")


def test_ratio_says_how_many_times_better_ours_is() -> None:
    """Half the peer's time, or twice its rate, is a ratio of 2; without a peer there is none."""
    time = report("a search", {"ours": 2.0, "theirs": 4.0}, unit="s")
    rate = report("images", {"ours": 0.5, "theirs": 1.0}, unit="images", count=1000)
    assert (time.ratio, rate.ratio, LONELY.ratio) == (2, 2, None)
    assert str(time) == "a search: ours 2 s, theirs 4 s; ratio 2.00"
    assert str(rate) == "images: ours 2,000 images/s, theirs 1,000 images/s; ratio 2.00"
    assert str(LONELY) == "memory: ours 12 MB"


def test_rivals_take_turns() -> None:
    """What else the machine does meets all of them."""
    order: list[str] = []
    medians({"ours": lambda: order.append("ours"), "theirs": lambda: order.append("theirs")}, rounds=2)
    assert order == ["ours", "theirs", "ours", "theirs"]


def test_time_of_a_process_that_still_runs_is_counted() -> None:
    """A zygote and a warm peer do not end between two measurements, nor do other users' processes count."""
    burning = "import time\nwhile time.process_time() < 0.5: pass\nprint(flush=True)\ninput()"
    before = descendants_seconds()
    with subprocess.Popen([sys.executable, "-c", burning], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        assert descendants_seconds() - before > 0.4
        process.stdin.close()
    assert descendants_seconds() - before > 0.4


def test_rivals_are_timed_by_the_clock_that_is_given() -> None:
    """Wall time tells nothing of a busy machine."""
    ticks = iter([0.0, 3.0, 10.0, 14.0])
    assert medians({"ours": print, "theirs": print}, rounds=1, clock=lambda: next(ticks)) == {"ours": 3, "theirs": 4}


def test_record_and_table_hold_what_was_found(tmp_path: Path) -> None:
    """The JSON has every figure; the page gets a row for each with a peer, and the date and machine above them."""
    figures = [report("a search", {"ours": 2.0, "theirs": 4.0}, unit="s"), LONELY]
    results, page = tmp_path / "bench.json", tmp_path / "README.md"
    page.write_text(f"{BEGIN}\n{END}\n", encoding="utf-8")
    write(record(figures, "2026-01-31", "1.2.3"), results, page)
    measured = json.loads(results.read_text(encoding="utf-8"))
    assert [(figure["title"], figure["ratio"]) for figure in measured["figures"]] == [("a search", 2), ("memory", None)]
    assert measured["versions"]["openevolve"] == "1.2.3"
    _, _, head, *_, row, _, _ = page.read_text(encoding="utf-8").splitlines()
    assert "2026-01-31" in head
    assert measured["machine"]["cpu"] in head
    assert row == "| a search | ours: 2 s | theirs: 4 s | 2.00 |"


def test_only_the_lines_between_the_markers_are_replaced() -> None:
    """A second measurement replaces the first and leaves the page around it."""
    page = f"before\n\n{BEGIN}\n\nold\n\n{END}\n\nafter\n"
    changed = with_table(page, ["new"])
    assert changed == page.replace("old", "new")
    assert with_table(changed, ["new"]) == changed


@pytest.mark.parametrize("page", ["nothing", BEGIN, END, f"{BEGIN}{END}{BEGIN}{END}"])
def test_page_without_its_two_markers_is_refused(page: str) -> None:
    """Nothing is written where it is not clear what to replace."""
    with pytest.raises(ValueError, match="each once"):
        with_table(page, ["new"])


def test_readme_holds_the_table_of_the_results() -> None:
    """Nobody has typed a figure; before the first measurement there is none."""
    page, results = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8"), ROOT / RESULTS
    lines = list(table(json.loads(results.read_text(encoding="utf-8")))) if results.exists() else []
    assert with_table(page, lines) == page


@pytest.mark.parametrize("measure", BENCHMARKS)
def test_quick_sizes_are_arguments_of_their_benchmark(measure: object) -> None:
    """`make bench-quick` is not the first to find a renamed one."""
    assert callable(measure)
    inspect.signature(measure).bind(**BENCHMARKS[measure])
