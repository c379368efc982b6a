"""What MLflow shows of a line of the ledger: its params and its metrics, and nothing that does not apply."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mirrored import (
    BASELINE,
    INSTRUCTIONS,
    MUTATION,
    REJECTED,
    SECOND_GENERATION,
)

from tacevo.costs import Spending
from tacevo.evolution.archive import AddStatus
from tacevo.evolution.lines import RepairedAnswer, SeedLine
from tacevo.records import Json, Reason, Stage
from tacevo.tracking.entries import (
    LONGEST_PARAM,
    Measure,
    candidate_measures,
    candidate_params,
    config_params,
    cost_measures,
    generation_measures,
    shorten,
)


def test_baseline_has_neither_parents_nor_instruction() -> None:
    """What does not apply to a candidate is left out."""
    assert candidate_params(BASELINE, INSTRUCTIONS) == {"operator": "baseline", "generation": "0", "slot": "0"}


def test_mutation_names_its_instruction() -> None:
    """A mutation's params hold the instruction's id and text, the parent and the request's temperature."""
    assert candidate_params(MUTATION, INSTRUCTIONS) == {
        "operator": "mutation",
        "generation": "0",
        "slot": "1",
        "temperature": "0.625",
        "parents": "g00s00",
        "instruction": "gelu",
        "instruction_text": "ReLU to GELU.",
    }


def test_setting_that_was_not_sent_is_named() -> None:
    """A temperature that the model refuses is not shown as sent."""
    params = candidate_params(replace(MUTATION, dropped=("temperature", "top_p")), INSTRUCTIONS)
    assert params["dropped"] == "temperature,top_p"
    assert "temperature" not in params


def test_rejected_crossover_says_where_and_why() -> None:
    """A crossover has both parents and no instruction of the library; a rejection its stage and reason."""
    params = candidate_params(REJECTED, INSTRUCTIONS)
    assert (params["parents"], params["instruction"]) == ("g00s00,g00s01", "crossover")
    assert (params["stage"], params["reason"]) == ("policy", "forbidden_import")
    assert "instruction_text" not in params
    assert candidate_measures(REJECTED) == ()


def test_losses_are_steps_from_epoch_one() -> None:
    """Each epoch's loss is a step of its metric."""
    measures = candidate_measures(BASELINE)
    assert [m for m in measures if m.key == "validation_loss"] == [
        Measure(key="validation_loss", value=0.5, step=1),
        Measure(key="validation_loss", value=0.25, step=2),
    ]


def test_loss_of_each_seed_is_a_step() -> None:
    """Where there are several; the fitness is that of the median."""
    seeds = tuple(
        SeedLine(seed=seed, evaluation="", train_losses=(), validation_losses=(0.9, loss), predictions="", weights="")
        for seed, loss in enumerate((0.3, 0.1, 0.2))
    )
    measures = candidate_measures(replace(BASELINE, seeds=seeds))
    assert [(one.step, one.value) for one in measures if one.key == "seed_loss"] == [(0, 0.3), (1, 0.1), (2, 0.2)]
    assert not any(one.key == "seed_loss" for one in candidate_measures(BASELINE))


@pytest.mark.parametrize("status", AddStatus)
def test_inserted_is_whether_the_archive_took_it(status: AddStatus) -> None:
    """A new niche and an improved one both count as an insertion."""
    measures = candidate_measures(replace(BASELINE, status=status))
    inserted = float(status is not AddStatus.rejected)
    assert Measure(key="inserted", value=inserted, step=0) in measures


def test_generation_without_trained_candidates_leaves_their_figures_out() -> None:
    """A generation's metrics are at its own step, and what is null is left out."""
    measures = generation_measures(SECOND_GENERATION)
    assert {measure.step for measure in measures} == {1}
    assert {measure.key for measure in measures} == {
        "best",
        "coverage",
        "qd_score",
        "prompt_coverage",
        "candidates",
        "trained",
        "temperature",
    }


def test_config_is_flattened() -> None:
    """A param's name is the key as the user writes it; lists and null are JSON."""
    config: dict[str, Json] = {
        "seed": 0,
        "llm": {"model": "m", "base_url": None},
        "data": {"target_columns": ["fx", "fy"]},
    }
    assert config_params(config) == {
        "seed": "0",
        "llm.model": "m",
        "llm.base_url": "null",
        "data.target_columns": '["fx", "fy"]',
    }


@given(st.text(max_size=3 * LONGEST_PARAM))
def test_shortened_text_fits_and_shows_that_it_was_cut(text: str) -> None:
    """A text that fits stays; a longer one is cut to fit and ends in an ellipsis."""
    short = shorten(text)
    assert len(short) <= LONGEST_PARAM
    assert short == text or (short.endswith("…") and text.startswith(short[:-1]) and len(text) > LONGEST_PARAM)


def test_cost_without_answers_or_price_is_absent() -> None:
    """A cost that is not known is not shown as zero."""
    spent = Spending(answers=1, input_tokens=10, output_tokens=20, usd=0.5)
    assert cost_measures(spent, 3) == tuple(
        Measure(key=key, value=value, step=3)
        for key, value in (("answers", 1.0), ("input_tokens", 10.0), ("output_tokens", 20.0), ("usd", 0.5))
    )
    unpriced = cost_measures(Spending(answers=1, input_tokens=10, output_tokens=20, unpriced=1), 0)
    assert "usd" not in {measure.key for measure in unpriced}
    assert cost_measures(Spending(), 0) == ()


def test_repairs_are_shown_apart() -> None:
    """A repaired candidate says how often it was sent back, and a generation how many trained after that."""
    repair = RepairedAnswer(answer="0", stage=Stage.probe, reason=Reason.bad_output)
    line = replace(MUTATION, repairs=(repair,))
    assert candidate_params(line, INSTRUCTIONS)["repairs"] == "1"
    measures = {measure.key: measure.value for measure in generation_measures(replace(SECOND_GENERATION, repaired=2))}
    assert measures["repaired"] == 2
