"""Promise: who watches a search reads how many of its candidates are done."""

import io
import itertools
import re
import time
from dataclasses import replace

import fakes
import pytest
from rich.console import Console
from waiting import eventually

from tacevo.evolution.algorithm import run_search
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.state import Budget, Plan
from tacevo.records import Training
from tacevo.rounding import significant
from tacevo.runs.progress import Progress, Watcher
from tacevo.storage.ledger import Ledger

PLAN = fakes.plan(generations=2)


@pytest.mark.parametrize(
    ("plan", "told"),
    [
        (PLAN, "(16 of 16 candidates done)"),
        (replace(PLAN, budget=Budget(flops=1, images=1, epochs=1)), "(4 of at most 16 candidates done)"),
    ],
)
def test_candidates_are_counted(plan: Plan, told: str) -> None:
    """A budget may end a search before all that were planned."""
    out = io.StringIO()
    run_search(plan, fakes.effects(), Ledger(), Watcher(plan, Progress(Console(file=out))))
    assert told in out.getvalue().splitlines()[-1]


@pytest.mark.parametrize(("trivial", "is_chance"), [(None, False), (0.001, True), (50.0, False)])
def test_best_stands_beside_baseline_and_trivial_loss(trivial: float | None, is_chance: bool) -> None:
    """In the line of every generation, from the first on; of a run that records no trivial loss, the baseline."""
    out = io.StringIO()
    baseline = fakes.evaluate(fakes.TASK.baseline)
    assert isinstance(baseline, Training)
    run_search(PLAN, fakes.effects(), Ledger(), Watcher(PLAN, Progress(Console(file=out)), trivial))
    lines = out.getvalue().splitlines()
    beside = f"baseline {significant(baseline.validation_losses[-1])}" + (
        "" if trivial is None else f", trivial {significant(trivial)}"
    )
    assert len(lines) == 3
    assert [line for line in lines if f"({beside})" not in line or ("at chance" in line) != is_chance] == []


@pytest.mark.parametrize(("pace", "told"), [(1.0, False), (600.0, True)])
def test_long_search_says_how_long_it_takes(pace: float, told: bool) -> None:
    """At its first training, and with every generation that much is left after; a short one says nothing of it."""
    out, done = io.StringIO(), fakes.Recorder()
    effects = replace(fakes.effects(), cpu_seconds=itertools.count().__next__)
    run_search(PLAN, effects, Ledger(), done)
    clock = itertools.count(0, pace).__next__
    run_search(PLAN, effects, Ledger(), Watcher(PLAN, Progress(Console(file=out)), clock=clock))
    left = [line for line in out.getvalue().splitlines() if " left)" in line]
    assert len(left) == (2 if told else 0)  # of three generations, the last has nothing left
    trained = next(outcome for outcome in done.outcomes if outcome.cpu_seconds)
    watcher = Watcher(PLAN, Progress(Console(file=out)), at_once=2, saving=lambda: 0.25)
    watcher.developed(replace(trained, cpu_seconds=0.0, seconds=1e6))  # recalled
    watcher.developed(replace(trained, seconds=pace))
    assert ("about 1.3 hours at the pace of the first training" in out.getvalue()) == told  # 16 slots of 600 s, by two
    assert ("portable512 would save about 20 minutes of it (25%)" in out.getvalue()) == told
    watcher.developed(replace(trained, seconds=1e6))
    assert out.getvalue().count("would save") == told  # once


def test_narrow_terminal_cuts_no_figure() -> None:
    """On 80 columns count, rate and time left are whole beside a long note, of which the beginning is kept."""
    text = io.StringIO()
    with Progress(Console(file=text, force_terminal=True, width=80, color_system=None)) as view:
        view.advance("candidates", 115, 128)
        view.advance("candidates", 120, 128, "best 1.03 (baseline 1.2, trivial 1.57), at chance, coverage 12%")
    last = next(line for line in reversed(text.getvalue().splitlines()) if "120/128" in line)
    assert re.search(r"candidates .*120/128 best 1\.03 \(.* \S+/(s|min) +\d:\d\d:\d\d left", last)


def test_log_is_never_silent_for_long() -> None:
    """Whatever works says how far it is, or that it works; nothing is said once it has ended."""
    text = io.StringIO()
    with Progress(Console(file=text, width=200), silence=0.05) as view:
        assert eventually(lambda: "at work" in text.getvalue(), seconds=20)
        view.advance("trainings", 4, 36)
        assert eventually(lambda: "trainings: 4 of 36, at work" in text.getvalue(), seconds=20)
        view.advance("trainings", 6, 36, "best 0.5")
        assert eventually(
            lambda: re.search("6 of 36, best 0.5, about .* left", text.getvalue()) is not None, seconds=20
        )
        view.advance("trainings", 0, 8)  # of another job
        assert eventually(lambda: "trainings: 0 of 8, at work" in text.getvalue(), seconds=20)


def test_what_was_recalled_enters_no_estimate() -> None:
    """No time is told before something was made; then it is that of what was made, from its own beginning on."""
    text = io.StringIO()
    with Progress(Console(file=text, width=200), silence=0.05) as view:
        view.advance("networks", 0, 1000)
        view.advance("networks", 500, 1000, recalled=True)
        assert eventually(lambda: "500 of 1000, at work" in text.getvalue(), seconds=20)
        time.sleep(1)
        began = time.monotonic()
        view.advance("networks", 900, 1000, recalled=True)
        time.sleep(0.2)
        view.advance("networks", 902, 1000)
        assert eventually(lambda: "902 of 1000, about" in text.getvalue(), seconds=20)
        took = time.monotonic() - began
    (told, *_) = re.findall(r"902 of 1000, about (\d+) seconds left", text.getvalue())
    assert (
        49 * 0.2 - 1 <= int(told) <= 49 * took + 1
    )  # two took so long, and 98 are left; the second before is not theirs


def test_recalled_candidates_enter_no_pace() -> None:
    """A search that recalls some of its networks between others tells the time of those that it trains."""
    done = fakes.Recorder()
    run_search(PLAN, replace(fakes.effects(), cpu_seconds=itertools.count().__next__), Ledger(), done)
    told = []
    for recalled in (set[str](), {"g01s00", "g01s01", "g01s02"}):
        out, clock = io.StringIO(), itertools.count(0, 1000).__next__
        watcher = Watcher(PLAN, Progress(Console(file=out)), clock=clock)
        states = iter(zip(done.lines, done.states, strict=True))
        outcomes = {one.proposal.id: one for one in done.outcomes}
        for line, state in states:
            if isinstance(line, CandidateLine):
                one = outcomes[line.id]
                watcher.developed(replace(one, cpu_seconds=0.0 if line.id in recalled else one.cpu_seconds, seconds=0))
            watcher.committed(line, state)
        told.append(re.findall(r"about (\S+) (\S+) left", out.getvalue()))
    fresh, mixed = told
    assert fresh[0] == mixed[0]  # generation 0, all of it trained
    assert fresh[1] != mixed[1]


def test_long_work_is_told_of_less_often() -> None:
    """A log of a day has a line a minute at most, and one that began has a word after five seconds."""
    view = Progress(Console(file=io.StringIO()))
    for lasted, pause in ((0, 5), (100, 5), (1000, 25), (100_000, 60)):
        view._last = view._began + lasted
        assert view._due - view._last == pytest.approx(pause)
