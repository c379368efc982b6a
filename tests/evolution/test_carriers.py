"""Promise: what carries a temperature stands in request, ledger and every place that speaks of temperatures.

Of runs whose temperature is sent as such, nothing changes: tests/evolution/test_proposals.py has their requests.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import fakes
import numpy as np
import pytest
from hand_runs import altered, closed, configured, of_lines, run, trained
from hand_sweeps import finished, run_to, sweep_of
from hypothesis import given
from hypothesis import strategies as st
from ledger_lines import header
from refusals import refused

from analysis.runs.dynamics import by_temperature
from analysis.runs.niches import Niches
from analysis.tables.ablation import settings_table
from analysis.tables.dynamics import generations_table, temperatures_table
from analysis.tables.niches import niches_table
from tacevo.choices import Carrier, Effort
from tacevo.config.compose import compose
from tacevo.config.task_texts import facts_without_data, load_task
from tacevo.errors import IncomparableError
from tacevo.evolution.archive import find_centroids
from tacevo.evolution.carriers import carry
from tacevo.evolution.lines import CandidateLine
from tacevo.evolution.parents import Nobody
from tacevo.evolution.proposals import Proposal
from tacevo.evolution.state import Plan
from tacevo.records import Operator, Request, written
from tacevo.results.run import RecordedRun
from tacevo.results.summary import summarise
from tacevo.results.sweep_checks import check_sweep

SENTENCES = ("Stay.", "Nudge.", "Change.", "Rework.", "Leap.")
EFFORTS = (Effort.low, Effort.medium, Effort.high, Effort.max)
NICHES = np.array(find_centroids(niches=4, dimensions=2, samples=100, seed=0))
EACH = pytest.mark.parametrize("carrier", [*Carrier])


def planned(carrier: Carrier, **changes: Any) -> Plan:
    """Return a small plan with a carrier."""
    plan = fakes.plan(carrier=carrier, efforts=EFFORTS, **changes)
    return replace(plan, task=replace(plan.task, boldness=SENTENCES))


def proposed(carrier: Carrier, **changes: object) -> list[tuple[Proposal, Request]]:
    """Search; return every proposal that asked, with its request."""
    _, recorder = fakes.search(planned(carrier, **changes))
    proposals = [outcome.proposal for outcome in recorder.outcomes]
    return [(one, one.request) for one in proposals if one.request is not None]


def lines_of(carrier: Carrier, **changes: object) -> list[CandidateLine]:
    """Search; return the lines of what was asked for."""
    _, recorder = fakes.search(planned(carrier, **changes))
    return [line for line in recorder.lines if isinstance(line, CandidateLine) and line.request]


@given(st.floats(0, 1), st.integers(1, 5))
def test_equal_parts_of_the_temperature_choose(temperature: float, count: int) -> None:
    """The parts are [0, 1/n), [1/n, 2/n), and so on; the last one holds 1."""
    efforts = tuple(Effort)[:count]
    carried = carry(temperature, by=Carrier.effort, sentences=(), efforts=efforts)
    assert carried.level is not None
    low, high = (carried.level - 1) / count, carried.level / count
    assert low - 1e-12 <= temperature <= high + 1e-12
    assert carried.effort is efforts[carried.level - 1]
    ends = [carry(end, by=Carrier.words, sentences=SENTENCES, efforts=()).level for end in (0.0, 0.2, 0.6, 1.0)]
    assert ends == [1, 2, 4, 5]


def test_request_holds_what_carries_its_temperature_and_nothing_else_of_it() -> None:
    """Words in the user message of mutations and crossovers, an effort among the settings, or nothing."""
    plain = proposed(Carrier.parameter)
    operators = {one.operator for one, _ in plain}
    assert operators == {Operator.mutation, Operator.crossover}
    for _, request in plain:
        assert request.temperature is not None
        assert not [sentence for sentence in SENTENCES if sentence in request.messages[0].content]
    for carrier in (Carrier.words, Carrier.effort, Carrier.none):
        for one, request in proposed(carrier):
            assert request.temperature is None
            assert one.carried is not None
            level, text = one.carried.level, request.messages[0].content
            held = [sentence for sentence in SENTENCES if sentence in text]
            assert held == ([SENTENCES[level - 1]] if carrier is Carrier.words and level else [])
            effort = dict(request.settings).get("effort")
            assert effort == (EFFORTS[level - 1] if carrier is Carrier.effort and level else None)
            assert (level is None) == (carrier is Carrier.none)


def test_requests_with_different_words_or_efforts_have_different_keys() -> None:
    """And those whose temperatures choose the same are one request, which arms share."""

    def keys(carrier: Carrier, start: float) -> list[str]:
        plan = replace(planned(carrier, jitter=0.0, generations=0), temperature_start=start)
        _, recorder = fakes.search(plan)
        return [line.request for line in recorder.lines if isinstance(line, CandidateLine) and line.request]

    for carrier in (Carrier.words, Carrier.effort):
        assert keys(carrier, 0.61) == keys(carrier, 0.7) != keys(carrier, 0.1)
    assert keys(Carrier.none, 0.1) == keys(Carrier.none, 0.9)


def test_network_without_a_parent_is_asked_for_without_words() -> None:
    """They say how far to depart from a parent; its line says that nothing carried its temperature."""
    lines = [line for line in lines_of(Carrier.words, parents=Nobody()) if line.operator is Operator.sample]
    assert lines
    assert {(line.level, line.sent_temperature) for line in lines} == {(None, None)}
    efforts = [line for line in lines_of(Carrier.effort, parents=Nobody()) if line.operator is Operator.sample]
    assert all(line.level for line in efforts)


@EACH
def test_ledger_has_temperature_carrier_and_what_was_chosen(carrier: Carrier) -> None:
    """A line has new fields only where something else than the parameter carries."""
    for line in lines_of(carrier):
        new = {name: value for name, value in written(line).items() if name in {"carrier", "level", "effort"}}
        assert line.temperature is not None
        words = {"carrier": "words", "level": min(int(line.temperature * 5), 4) + 1}
        level = min(int(line.temperature * 4), 3)
        effort = {"carrier": "effort", "level": level + 1, "effort": EFFORTS[level].value}
        expected = {"parameter": {}, "words": words, "effort": effort, "none": {"carrier": "none"}}
        assert new == expected[carrier]
        assert line.sent_temperature == (None if carrier is Carrier.none else line.temperature)


@EACH
def test_search_with_any_carrier_is_replayed_bit_for_bit(carrier: Carrier, tmp_path: Path) -> None:
    """The same fold gives the lines that stand in its ledger, and the temperatures move as ever."""
    digest, recorder = fakes.search(planned(carrier), tmp_path / "ledger.jsonl")
    assert fakes.search(planned(carrier), tmp_path / "ledger.jsonl")[0] == digest
    assert [state.temperature for state in recorder.states][-1] > 0.6


def test_answers_that_are_sent_back_keep_their_words() -> None:
    """The conversation that a repair goes on with begins with the sentence."""
    plan = replace(planned(Carrier.words), repairs=1)
    seen: list[Request] = []

    class Heard(fakes.FakeLLM):
        def complete(self, requests: Sequence[Request]) -> object:  # type: ignore[override]
            seen.extend(requests)
            return super().complete(requests)

    fakes.search(plan, llm=Heard())
    again = [request for request in seen if len(request.messages) > 1]
    assert again
    assert all("Boldness " in request.messages[0].content and request.temperature is None for request in again)


def carried_by(carrier: str) -> RecordedRun:
    """Make a run by hand whose temperatures something carries."""
    chosen: dict[str, Any] = {"words": {"level": 4}, "effort": {"level": 3, "effort": Effort.high}, "none": {}}
    asked = [
        replace(trained(1, slot, prompt=slot % 2), carrier=Carrier(carrier), **chosen[carrier]) for slot in range(3)
    ]
    one = run([trained(0, 0), *asked], [closed(0), closed(1)])
    return altered(one, config=configured(temperature={"carrier": carrier}))


@pytest.mark.parametrize("carrier", ["words", "effort", "none"])
@pytest.mark.room("figures")
def test_figures_of_temperatures_say_the_carrier(carrier: str) -> None:
    """At their axes, and in their captions."""
    from analysis.figures.by_generation import temperature
    from analysis.figures.maps import prompt_map
    from analysis.report.figure_list import run_pictures

    hand, by = carried_by(carrier), "nothing" if carrier == "none" else carrier
    for figure in (temperature(hand), prompt_map(hand, NICHES, range(len(NICHES)))):
        labels = figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        assert any(label.endswith(f"(carried by {by})") for label in labels)
        assert bool(figure.axes[0].get_title()) == (carrier == "none")
    captions = {one.name: one.caption for one in run_pictures(hand, Niches(networks=NICHES, prompts=NICHES))}
    assert {name for name, caption in captions.items() if f"carried by {by}" in caption} == {
        "temperature",
        "prompt_map",
    }


@pytest.mark.parametrize(("carrier", "band"), [("words", "sentence 4: 0.6-0.8"), ("effort", "high: 0.5-0.75")])
def test_tables_of_temperatures_say_the_carrier(carrier: str, band: str) -> None:
    """A row for each sentence or effort; all have a note, and a column of temperatures says it in its name."""
    hand = carried_by(carrier)
    assert [*by_temperature(hand).name] == [band]
    for table in (temperatures_table(hand), generations_table(hand, NICHES)):
        assert hand.carrier_note in table.notes
        assert [name for name in table.columns if f"(carried by {carrier})" in name]


def test_nothing_that_carries_makes_temperatures_nominal() -> None:
    """No band of temperatures was tried, and T of a generation is what was planned: no alarm, for it was asked for."""
    hand = carried_by("none")
    words = "temperature was not sent: temperature.carrier=none"
    assert temperatures_table(hand).rows == ()
    assert f"{words}." in temperatures_table(hand).notes
    assert f"T is what was planned; {words}." in generations_table(hand, NICHES).notes
    assert "carried by nothing" in " ".join(niches_table(hand, Niches(networks=NICHES, prompts=NICHES)).notes)


@pytest.mark.room("alarms")
def test_temperature_that_is_nominal_raises_no_alarm() -> None:
    """Where words carry it, one that is stuck still does."""
    from analysis.runs.health import alarms

    stuck: dict[str, Any] = {"generations": tuple(closed(number, temperature=1.0) for number in range(4))}
    raised = {
        carrier: [alarm.name for alarm in alarms(altered(carried_by(carrier), **stuck), NICHES)]
        for carrier in ("none", "words")
    }
    assert "stuck temperature" in raised["words"]
    assert not [name for name in raised["none"] if "temperature" in name]


@pytest.mark.parametrize("carrier", ["words", "effort", "none"])
def test_summary_says_the_carrier(carrier: str) -> None:
    """Above the findings, and over the column of temperatures."""
    config = compose(["experiment=published_force", f"temperature.carrier={carrier}"])
    _, recorder = fakes.search(planned(Carrier(carrier)))
    page = summarise(of_lines(header(), *recorder.lines, config=config))
    assert f"T (carried by {'nothing' if carrier == 'none' else carrier})" in page
    assert ("T is carried by" in page) == (carrier != "none")
    assert ("temperature was not sent: temperature.carrier=none. T, and" in page) == (carrier == "none")


def test_arms_may_differ_in_the_carrier() -> None:
    """None among them; but two searches in which nothing carries them are one, whatever the rule would say."""
    carriers = {name: {"temperature": {"carrier": name}} for name in ("parameter", "words", "none")}
    one = run_to(0.5, 0.4)
    jobs = [finished(name, 0, one, settings=settings) for name, settings in carriers.items()]
    check_sweep(sweep_of(jobs))
    (row,) = (row for row in settings_table(sweep_of(jobs)).rows if row[0] == "temperature.carrier")
    assert row[1:] == ("parameter", "words", "none")
    idle = finished("fixed", 0, one, settings={"temperature": {"carrier": "none", "rule": "fixed"}})
    with refused(IncomparableError, place="temperature", expected="because nothing carries them", got="none-seed0"):
        check_sweep(sweep_of([*jobs, idle]))


def test_task_of_another_carrier_is_the_task_of_before() -> None:
    """Its hash is in the first line of every ledger, so sentences enter only where they are used."""
    plain = compose(["experiment=demo"])
    task = load_task(plain, facts_without_data(plain))
    worded = compose(["experiment=demo", "temperature.carrier=words"])
    boldness = load_task(worded, facts_without_data(worded)).boldness
    assert len(set(boldness)) == 5
    assert task == replace(load_task(worded, facts_without_data(worded)), boldness=())
    assert "boldness" not in written(task)


def test_candidate_of_an_earlier_release_was_sent_its_temperature() -> None:
    """Its line has none of the new fields."""
    line = trained(1, 0, temperature=0.6)
    assert (line.carrier, line.level, line.sent_temperature) == (Carrier.parameter, None, 0.6)
