"""Promise: a setting that a model refuses, and that was therefore not sent, is told wherever a run speaks of it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import fakes
import numpy as np
import pytest
from hand_runs import altered, closed, of_lines, run, trained
from hand_sweeps import finished, run_to, sweep_of
from ledger_lines import header
from refusals import refused

from analysis.runs.niches import Niches
from analysis.tables.dynamics import generations_table, temperatures_table
from tacevo.config.compose import compose
from tacevo.errors import IncomparableError
from tacevo.evolution.archive import find_centroids
from tacevo.evolution.lines import CandidateLine, SearchLine, not_sent
from tacevo.records import Completion, Request
from tacevo.results.run import RecordedRun
from tacevo.results.summary import summarise
from tacevo.results.sweep_checks import check_sweep
from tacevo.rules import FIRST
from tacevo.runs.search_files import run_under
from tacevo.storage.ledger import Ledger

WORDS = "temperature was not sent: the model refuses it"
NICHES = np.array(find_centroids(niches=4, dimensions=2, samples=100, seed=0))


class Refusing(fakes.FakeLLM):
    """Answers as the fake does, without the temperature."""

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer, and say what was not sent."""
        for position, completion in super().complete(requests):
            yield position, replace(completion, dropped=("temperature", "top_p"))


def answered_in(lines: Sequence[SearchLine]) -> list[CandidateLine]:
    """List the lines of candidates that a model answered for."""
    return [line for line in lines if isinstance(line, CandidateLine) and line.answer]


def without_temperatures() -> RecordedRun:
    """Make a run whose model refuses temperatures."""
    asked = [trained(1, slot, prompt=slot % 2, dropped=("temperature",)) for slot in range(3)]
    return run([trained(0, 0), *asked], [closed(0), closed(1, temperature=1.0)])


def searched(llm: fakes.FakeLLM, core: int = 2) -> list[SearchLine]:
    """Search under the rules of a core, with answers that are sent back; return the lines of the ledger."""
    recorder, plan = fakes.Recorder(), replace(fakes.plan(generations=2), repairs=1)
    run_under(replace(FIRST, core=core), plan, lambda _: fakes.effects(llm), Ledger(), recorder)
    return recorder.lines


def test_ledger_names_what_was_not_sent() -> None:
    """Every answer does, also one that was sent back, and nothing else in its line changes.

    Where all was sent, no line does; nor under the first core, whose answers are recorded with what was dropped.
    """
    told, plain, first = searched(Refusing()), searched(fakes.FakeLLM()), searched(Refusing(), core=1)
    assert {line.dropped for line in answered_in(told)} == {("temperature", "top_p")}
    assert {sent.dropped for line in answered_in(told) for sent in line.repairs} == {("temperature", "top_p")}
    assert plain == first == [without(line) if isinstance(line, CandidateLine) else line for line in told]
    assert {line.sent_temperature is None for line in answered_in(told)} == {True}
    assert {line.sent_temperature == line.temperature for line in answered_in(plain)} == {True}


def without(line: CandidateLine) -> CandidateLine:
    """Take what was not sent out of a line."""
    return replace(line, dropped=(), repairs=tuple(replace(sent, dropped=()) for sent in line.repairs))


def test_summary_says_it() -> None:
    """And that T is what was planned; of a model that changed its mind, with how many requests."""
    assert not_sent([("temperature",), ("temperature", "top_p")]) == {
        "temperature": WORDS,
        "top_p": "top_p was not sent with 1 of 2 requests: the model refuses it",
    }
    lines, plain = searched(Refusing()), searched(fakes.FakeLLM())
    config = compose(["experiment=published_force"])
    page = summarise(of_lines(header(), *lines, config=config))
    assert f"{WORDS}. top_p was not sent: the model refuses it. T, and the temperatures of the prompt archive" in page
    assert "not sent" not in summarise(of_lines(header(), *plain, config=config))


@pytest.mark.room("alarms")
def test_health_page_says_it_instead_of_a_stuck_temperature() -> None:
    """A temperature that nobody was sent is not stuck."""
    from analysis.runs.health import alarms

    hand = without_temperatures()
    stuck = altered(hand, generations=tuple(closed(number, temperature=1.0) for number in range(4)))
    raised = [alarm for alarm in alarms(stuck, NICHES) if "temperature" in alarm.name]
    assert [(alarm.name, alarm.figures) for alarm in raised] == [("temperature not sent", {"requests": 3})]
    assert raised[0].sentence.startswith(WORDS)


@pytest.mark.room("figures")
def test_figures_of_temperatures_say_it() -> None:
    """In their titles and below them; the figure of temperatures shows no request at one."""
    from analysis.figures.by_generation import temperature
    from analysis.figures.maps import prompt_map
    from analysis.report.figure_list import run_pictures

    hand = without_temperatures()
    for figure in (temperature(hand), prompt_map(hand, NICHES, range(len(NICHES)))):
        assert figure.axes[0].get_title().replace("\n", " ") == WORDS
    assert [line.get_label() for line in temperature(hand).axes[0].lines] == ["$T_g$ of the generation"]
    captions = {
        picture.name: picture.caption for picture in run_pictures(hand, Niches(networks=NICHES, prompts=NICHES))
    }
    assert {name for name, caption in captions.items() if WORDS in caption} == {"temperature", "prompt_map"}
    sent = run([trained(0, 0), trained(1, 0)], [closed(0), closed(1)])
    for figure in (temperature(sent), prompt_map(sent, NICHES, range(len(NICHES)))):
        assert figure.axes[0].get_title() == ""


def test_tables_of_temperatures_say_it() -> None:
    """No band of temperatures was tried, and T of a generation is what was planned."""
    hand = without_temperatures()
    assert temperatures_table(hand).rows == ()
    assert f"{WORDS}." in temperatures_table(hand).notes
    assert generations_table(hand, NICHES).notes[-1] == f"T is what was planned; {WORDS}."


def test_arms_over_temperature_are_no_comparison() -> None:
    """Where one of both was not sent any; seeds of one arm, and arms over something else, still are."""
    idle = altered(run_to(0.5, 0.4), candidates=without_temperatures().candidates)
    others = [finished("none", 0, idle), finished("none", 1, idle), finished("no_qd", 0, idle)]
    check_sweep(sweep_of(others))
    rule = {"temperature": {"rule": "fixed"}}
    fixed = finished("fixed_temperature", 0, idle, settings=rule)
    got = f"none-seed0 and fixed_temperature-seed0, and in none-seed0 {WORDS}"
    with refused(
        IncomparableError, place="temperature", expected="equal temperatures", got=got, remedy="delete the dir"
    ):
        check_sweep(sweep_of([*others, fixed]))
    sent = run_to(0.5, 0.4)
    check_sweep(sweep_of([finished("none", 0, sent), finished("fixed_temperature", 0, sent, settings=rule)]))
