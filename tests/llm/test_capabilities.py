"""Promise: what is known of a model follows from what its server told and from recorded answers, or it is unknown."""

from pathlib import Path
from typing import Any

import pytest
from asked import request
from hypothesis import given
from hypothesis import strategies as st
from llm_models import MODELS
from refusals import refused

from tacevo.choices import Effort
from tacevo.errors import StoreError
from tacevo.llm.capabilities import (
    Capabilities,
    known_capabilities,
    question,
    read_capabilities,
    recorded_capabilities,
    takes_temperature,
)
from tacevo.llm.recording import choice
from tacevo.records import Completion, Json, to_json
from tacevo.storage.store import Store

CURRENT = Capabilities(temperature=False, efforts=tuple(Effort), thinkings=("adaptive", "disabled"))

#: Any JSON, whose objects often have the names that the Models API has.
NAMES = ("capabilities", "effort", "thinking", "types", "supported", "low", "adaptive", "enabled", "retires_at")
ANY = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False)
    | st.text(max_size=9)
    | st.just("2026-13-01"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(NAMES), inner, max_size=6),
    max_leaves=20,
)


@pytest.mark.parametrize(
    ("model", "known"),
    [
        ("claude-haiku-5-5", CURRENT),
        ("claude-opus-5-5", Capabilities(temperature=False, efforts=tuple(Effort), thinkings=("adaptive",))),
        ("claude-haiku-4-5", Capabilities(efforts=(), thinkings=("disabled", "enabled"))),
    ],
)
def test_models_api_tells_efforts_and_thinkings(model: str, known: Capabilities) -> None:
    """Only a model whose thinking is adaptive alone is thought to take no temperature, which nobody tells."""
    assert read_capabilities(MODELS[model].told(model)) == known


@given(ANY)
def test_any_answer_is_read_and_can_be_recorded(told: Json) -> None:
    """No JSON of a server is an error, and nothing but known words comes out of it."""
    known = read_capabilities(told)
    assert set(known.efforts or ()) <= set(Effort)
    assert set(known.thinkings or ()) <= {"adaptive", "disabled", "enabled"}
    assert known.retires is None or len(known.retires) == 10


@pytest.mark.parametrize(
    ("dropped", "text", "expected"),
    [(("temperature",), "a", False), ((), "a", True), (("top_p",), "a", True), ((), "", None)],
)
def test_recorded_answers_tell_of_the_temperature(
    dropped: tuple[str, ...], text: str, expected: bool | None, tmp_path: Path
) -> None:
    """One that was given to the same model, token limit and settings weighs more than what follows from the API."""
    asked, completions, models = request("q"), Store(tmp_path, "completions"), Store(tmp_path, "models")
    answer = Completion(text=text, model="m", stop_reason="end_turn", input_tokens=1, output_tokens=1, dropped=dropped)
    completions.write(to_json(asked), to_json(answer))
    assert known_capabilities(models, completions, "anthropic", choice(asked)) == Capabilities(temperature=expected)
    models.write(question("anthropic", asked.model), to_json(CURRENT))
    told = known_capabilities(models, completions, "anthropic", choice(asked))
    assert (told.temperature, told.efforts) == (False if expected is None else expected, CURRENT.efforts)
    other = choice(request("q", settings=(("top_k", 5),)))
    assert known_capabilities(models, completions, "anthropic", other) == CURRENT


def test_servers_are_told_apart_by_what_they_say_of_one_name(tmp_path: Path) -> None:
    """The provider's own server has the key that it always had; who knows no server finds its word, or another's."""
    models, other = Store(tmp_path, "models"), Capabilities(efforts=())
    models.write(question("anthropic", "m", "other"), to_json(other))
    models.write(question("anthropic", "n", "third"), to_json(CURRENT))
    assert recorded_capabilities(models, "anthropic", "m", "") is None
    assert recorded_capabilities(models, "anthropic", "m", "third") is None
    assert recorded_capabilities(models, "anthropic", "m", "other") == other
    assert recorded_capabilities(models, "anthropic", "m") == other
    models.write({"provider": "anthropic", "model": "m"}, to_json(CURRENT))
    assert recorded_capabilities(models, "anthropic", "m", "") == CURRENT
    assert recorded_capabilities(models, "anthropic", "m", "other") == other
    assert recorded_capabilities(models, "anthropic", "m") == CURRENT
    assert recorded_capabilities(models, "openai", "m") is None


def test_damaged_entry_of_a_model_is_named(tmp_path: Path) -> None:
    """What cannot be read is neither guessed nor asked for anew."""
    models = Store(tmp_path, "models")
    models.write(question("anthropic", "m"), {"efforts": ["huge"]})
    with refused(StoreError, place="models", remedy="delete that file"):
        known_capabilities(models, Store(tmp_path, "completions"), "anthropic", ("m", 1, ()))


@pytest.mark.parametrize(
    ("settings", "temperature", "takes"),
    [
        ((), None, None),
        ((), True, True),
        ((("thinking", "disabled"),), True, True),
        ((("thinking", "adaptive"),), True, False),
        ((("thinking", 1024),), None, False),
    ],
)
def test_no_temperature_is_taken_while_a_model_thinks(settings: Any, temperature: bool | None, takes: bool) -> None:
    """Whatever the model takes otherwise."""
    assert takes_temperature(Capabilities(temperature=temperature), settings) is takes
