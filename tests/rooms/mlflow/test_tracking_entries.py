"""What MLflow shows of a line of the ledger: its params and its metrics, and nothing that does not apply."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mirrored import BASELINE, GENERATION, INSTRUCTIONS, MUTATION, REJECTED, SECOND_GENERATION

from tacevo.choices import Carrier, Effort
from tacevo.costs import Spending
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import CandidateLine, RepairedAnswer
from tacevo.records import Json, Reason, Stage
from tacevo.tracking.shown import (
    LONGEST_PARAM,
    Point,
    Totals,
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
    note,
    shorten,
)

ASKED = {
    "operator": "mutation",
    "generation": "0",
    "slot": "1",
    "temperature": "0.625",
    "parents": "g00s00",
    "instruction": "gelu",
    "instruction_text": "ReLU to GELU.",
}

#: What was dropped is not shown as sent.
DROPPED = {**{key: value for key, value in ASKED.items() if key != "temperature"}, "dropped": "temperature,top_p"}

REPAIRED = replace(MUTATION, repairs=(RepairedAnswer(answer="0", stage=Stage.probe, reason=Reason.bad_output),))


@pytest.mark.parametrize(
    ("line", "params"),
    [
        (BASELINE, {"operator": "baseline", "generation": "0", "slot": "0"}),
        (MUTATION, ASKED),
        (replace(MUTATION, dropped=("temperature", "top_p")), DROPPED),
        (replace(MUTATION, carrier=Carrier.words, level=4), {**ASKED, "carrier": "words", "level": "4"}),
        (
            replace(MUTATION, carrier=Carrier.effort, level=3, effort=Effort.high),
            {**ASKED, "carrier": "effort", "level": "3", "effort": "high"},
        ),
        (
            replace(MUTATION, carrier=Carrier.none),
            {**{key: value for key, value in ASKED.items() if key != "temperature"}, "carrier": "none"},
        ),
        (REPAIRED, {**ASKED, "repairs": "1"}),
        (
            REJECTED,
            {
                "operator": "crossover",
                "generation": "0",
                "slot": "2",
                "temperature": "0.6",
                "parents": "g00s00,g00s01",
                "instruction": "crossover",
                "stage": "policy",
                "reason": "forbidden_import",
            },
        ),
    ],
)
def test_params_say_how_a_candidate_was_asked_for_and_why_it_was_rejected(
    line: CandidateLine, params: dict[str, str]
) -> None:
    """What does not apply to a candidate is left out."""
    assert candidate_params(line, INSTRUCTIONS) == params


def named(points: tuple[Point, ...], name: str) -> list[tuple[int, float]]:
    """Return step and value of a metric."""
    return [(step, value) for key, value, step in points if key == name]


def test_losses_are_steps_by_epoch() -> None:
    """From 1."""
    assert named(candidate_measures(BASELINE), "validation_loss") == [(1, 0.5), (2, 0.25)]
    assert candidate_measures(REJECTED) == ()


@pytest.mark.parametrize("status", AddStatus)
def test_inserted_is_whether_the_archive_took_it(status: AddStatus) -> None:
    """A new niche and an improved one both count as an insertion."""
    points = candidate_measures(replace(BASELINE, status=status))
    assert named(points, "inserted") == [(0, float(status is not AddStatus.rejected))]


def test_figures_of_a_generation_are_at_its_step_and_those_that_it_lacks_are_left_out() -> None:
    """As where nothing was trained; those after a repair are apart, and the losses beside the best may not be known."""
    bare = ["best", "coverage", "qd_score", "prompt_coverage", "candidates", "trained", "temperature"]
    points = generation_measures(SECOND_GENERATION)
    assert [key for key, _, _ in points] == bare
    assert {step for _, _, step in points} == {1}
    beside = generation_measures(replace(SECOND_GENERATION, repaired=2), baseline=0.5, trivial=0.75)
    assert {key: value for key, value, _ in beside if key not in bare} == {
        "repaired": 2,
        "baseline": 0.5,
        "trivial": 0.75,
    }


def test_config_is_flattened() -> None:
    """A param's name is the key as the user writes it; lists and null are JSON."""
    config: dict[str, Json] = {"seed": 0, "llm": {"model": "m", "base_url": None}, "data": {"columns": ["fx", "fy"]}}
    assert config_params(config) == {
        "seed": "0",
        "llm.model": "m",
        "llm.base_url": "null",
        "data.columns": '["fx", "fy"]',
    }


@given(st.text(max_size=3 * LONGEST_PARAM))
def test_shortened_text_fits_and_shows_that_it_was_cut(text: str) -> None:
    """A text that fits stays; a longer one is cut to fit and ends in an ellipsis."""
    short = shorten(text)
    assert len(short) <= LONGEST_PARAM
    assert short == text or (short.endswith("…") and text.startswith(short[:-1]) and len(text) > LONGEST_PARAM)


def test_long_summary_is_cut_at_a_line() -> None:
    """Older servers refuse a longer tag; its end says where all of it is."""
    summary = "".join(f"| row {number} |\n" for number in range(1_000))
    cut = note(summary, "summary.md")
    assert len(cut) <= 5_000
    assert summary.startswith(cut.partition("\n\n…")[0])
    assert cut.endswith("summary.md, among the artifacts)")


@pytest.mark.parametrize(
    ("spent", "shown"),
    [
        (
            Spending(answers=1, input_tokens=10, output_tokens=20, usd=0.5),
            {"answers": 1, "input_tokens": 10, "output_tokens": 20, "usd": 0.5},
        ),
        (
            Spending(answers=1, input_tokens=10, output_tokens=20, unpriced=1),
            {"answers": 1, "input_tokens": 10, "output_tokens": 20},
        ),
        (Spending(answers=1, uncounted=1, unpriced=1), {"answers": 1}),
        (Spending(), {}),
    ],
)
def test_cost_that_is_not_known_is_not_shown_as_zero(spent: Spending, shown: dict[str, float]) -> None:
    """Without answers there is none."""
    assert cost_measures(spent, 3) == tuple((key, value, 3) for key, value in shown.items())


def test_totals_add_up_what_generations_say() -> None:
    """Improvement on generation 0, mean trainable share from generation 1 on, evaluations and costs so far."""
    second = replace(GENERATION, generation=1, candidates=4, trained=1, repaired=2, best=0.125)
    third = replace(second, generation=2, trained=3, repaired=0)
    totals = Totals()
    totals.after(GENERATION, Spending())
    totals.after(second, Spending(answers=1, input_tokens=5, usd=0.5))
    points = totals.after(third, Spending(answers=2, input_tokens=7, usd=0.25))
    assert {step for _, _, step in points} == {2}
    assert {key: value for key, value, _ in points} == {
        "trained_candidates": 8,
        "improvement": 0.5,
        "trainable_rate": 0.5,
        "total_answers": 3,
        "total_input_tokens": 12,
        "total_output_tokens": 0,
        "total_usd": 0.75,
    }


def test_totals_leave_out_what_does_not_apply_yet() -> None:
    """Before anything is trained there is no improvement; generation 0 has no share of trainable answers."""
    nothing = replace(SECOND_GENERATION, generation=0, candidates=1, best=None)
    assert Totals().after(nothing, Spending()) == (("trained_candidates", 0, 0),)
