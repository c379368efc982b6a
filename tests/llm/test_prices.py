"""Promise: a price is found by a model's name, with or without its date, or not at all; a worst case is the worst."""

from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import yaml
from asked import request as asking
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from tacevo.config.compose import compose
from tacevo.errors import ConfigError
from tacevo.llm.prices import PriceTable, likely_tokens, line_to_add, most_input_tokens, worst_case
from tacevo.records import Completion, Delivery, Price, Request, to_json
from tacevo.runs.providers import load_prices

TABLE = load_prices("prices.yaml")
ENTRY: dict[str, Any] = {"input_usd": 1, "output_usd": 2.0, "dated": "2026-11-21", "source": "a page"}

LONG: dict[str, Any] = {"above_tokens": 10, "input_usd": 1, "output_usd": 2.0}


def request(text: str = "hello", *, model: str = "claude-3-haiku-20240307", max_tokens: int = 100) -> Request:
    """Make a request."""
    return replace(asking(text), model=model, max_tokens=max_tokens)


def answer(model: str, delivery: Delivery = Delivery.direct) -> Completion:
    """Make an answer by a model."""
    return Completion(text="", model=model, stop_reason="end_turn", input_tokens=1, output_tokens=1, delivery=delivery)


def test_shipped_table_is_dated_and_knows_the_default_model() -> None:
    """Every price says its day; the default model has one and is not retired, as the paper's model is."""
    default = compose(["llm=anthropic"]).llm.model
    assert default == "claude-haiku-4-5-20251001"
    assert TABLE.price(default, Delivery.direct) == Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21")
    assert TABLE.retirement(default) is None
    assert TABLE.retirement("claude-3-haiku-20240307") == "2026-04-20"
    assert {"claude-3-haiku", "claude-opus-4", "grammar-1"}.isdisjoint(TABLE.offered)
    assert "claude-haiku-4-5" in TABLE.offered


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("claude-haiku-4-5", True),
        ("claude-haiku-4-5-20251001", True),
        ("claude-haiku-4-5@20251001", True),
        ("claude-haiku-4-5-large", False),
        ("claude-haiku-4", False),
        ("my-claude-haiku-4-5", False),
        ("", False),
    ],
)
def test_name_is_found_with_or_without_its_date_and_by_nothing_else(name: str, known: bool) -> None:
    """A price is never guessed from a similar name: another model has another price."""
    assert (TABLE.price(name, Delivery.direct) is not None) == known


def test_model_that_answered_is_priced_before_the_one_that_was_asked() -> None:
    """What is billed is what answered; a name that the table lacks falls back to the name that was asked."""
    asked = request()
    assert TABLE.price_of(asked, answer("claude-opus-5")) == TABLE.price("claude-opus-5", Delivery.direct)
    assert TABLE.price_of(asked, answer("something else")) == TABLE.price("claude-3-haiku", Delivery.direct)
    assert TABLE.price_of(request(model="llama"), answer("something else")) is None


def test_delivery_of_the_answer_decides_the_price() -> None:
    """An answer that came by a batch has the batch's price, whatever the run asked for."""
    price = TABLE.price_of(request(), answer("claude-3-haiku", Delivery.batch))
    direct = TABLE.price("claude-3-haiku", Delivery.direct)
    assert price is not None
    assert direct is not None
    assert price.factor == TABLE.batch_factor == 0.5
    assert price.cost(1000, 1000) == direct.cost(1000, 1000) / 2


@given(st.text(max_size=50), st.text(max_size=50))
def test_worst_case_counts_every_byte(system: str, text: str) -> None:
    """No tokeniser that makes at most one token of a byte exceeds the bound, nor the usual rule of thumb."""
    asked = replace(request(text), system=system)
    size = len(system.encode(errors="replace")) + len(text.encode(errors="replace"))
    assert most_input_tokens(asked) > size
    assert most_input_tokens(asked) > likely_tokens(system) + likely_tokens(text)


def test_worst_case_is_priced_with_the_longest_answer() -> None:
    """By hand: 14 bytes and 2 turns of 64 tokens in, 100 tokens out, at 1 and 2 dollars."""
    price = Price(input_usd=1.0, output_usd=2.0, dated="2026-11-21")
    assert worst_case(price, request()) == pytest.approx((14 + 128 + 200) / 1e6)


def test_long_prompt_has_a_price_of_its_own() -> None:
    """By hand, at 0.10 and 0.50 dollars up to 100,000 tokens and five times that beyond, of all tokens of a request."""
    listed, asked = TABLE.price("claude-haiku-5-5", Delivery.batch), request(model="claude-haiku-5-5")
    assert listed is not None
    read = replace(answer("claude-haiku-5-5"), delivery=Delivery.batch)
    short, long = (TABLE.price_of(asked, replace(read, input_tokens=tokens)) for tokens in (100_000, 100_001))
    assert short is not None
    assert long is not None
    assert (short.cost(1e6, 1e6), long.cost(1e6, 1e6)) == (0.3, 1.5)
    assert "long" not in to_json(short).keys() | to_json(long).keys()
    assert TABLE.price_of(replace(asked, system="x" * 100_001), replace(read, input_tokens=None)) == long
    assert worst_case(listed, request(model="claude-haiku-5-5")) == pytest.approx(short.cost(142, 100))
    assert worst_case(listed, request("x" * 100_000, model="claude-haiku-5-5")) == pytest.approx(
        long.cost(100_137, 100)
    )


@pytest.mark.parametrize("name", ["claude-x", "llama3:8b", "a/b", "- x", "{", 'say "hi"'])
def test_line_that_a_table_lacks_is_one_that_it_takes(name: str, tmp_path: Path) -> None:
    """With numbers, a day and a page in place of its words, whatever the model is called."""
    line = line_to_add(name)
    for word, value in {": X": ": 1", ": Y": ": 2", "YYYY-MM-DD": "2026-11-28", "PAGE": "mine"}.items():
        line = line.replace(word, value)
    (tmp_path / "my.yaml").write_text(f"batch_factor: 0.5\nmodels:\n  {line}\n", encoding="utf-8")
    price = load_prices(str(tmp_path / "my.yaml")).price(name, Delivery.direct)
    assert price == Price(input_usd=1.0, output_usd=2.0, dated="2026-11-28")


@pytest.mark.parametrize(
    ("table", "key"),
    [
        (None, ""),
        ({"models": {}}, "batch_factor"),
        ({"batch_factor": 0.5, "models": []}, "models"),
        ({"batch_factor": "half", "models": {}}, "batch_factor"),
        ({"batch_factor": True, "models": {}}, "batch_factor"),
        ({"batch_factor": 0.5, "models": {"m": 5}}, "models.m"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "input": 1}}}, "models.m.input"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "input_usd": -1}}}, "models.m.input_usd"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "output_usd": float("nan")}}}, "models.m.output_usd"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "retired": "soon"}}}, "models.m.retired"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "long": {**LONG, "input_usd": -1}}}}, "models.m.long"),
        ({"batch_factor": 0.5, "models": {"m": {**ENTRY, "long": {**LONG, "more": 1}}}}, "models.m.long.more"),
    ],
)
def test_malformed_table_is_refused_by_its_key(table: object, key: str, tmp_path: Path) -> None:
    """A price that is not sound is the user's to mend, and is never read as something else."""
    with refused(ConfigError, place=f"llm.prices={tmp_path}/my.yaml" + (f", {key}" if key else "")):
        load(tmp_path, table)


def test_missing_table_is_refused() -> None:
    """A table that the user names must be there."""
    with refused(ConfigError, place="llm.prices", got="mine.yaml"):
        load_prices("mine.yaml")


def test_table_of_ones_own_is_read(tmp_path: Path) -> None:
    """A model that the shipped table lacks can be given a price without touching it; days need no quotes."""
    table = load(tmp_path, {"batch_factor": 1, "models": {"llama": {**ENTRY, "dated": date(2026, 11, 21)}}})
    assert table.price("llama", Delivery.batch) == Price(input_usd=1.0, output_usd=2.0, dated="2026-11-21")


def load(folder: Path, table: object) -> PriceTable:
    """Write a table and read it."""
    path = folder / "my.yaml"
    path.write_text(yaml.safe_dump(table), encoding="utf-8")
    return load_prices(str(path))


def test_cached_tokens_are_priced_where_the_table_says_what_they_cost(tmp_path: Path) -> None:
    """Only an answer that has such tokens is recorded with their price; without one its cost is unknown."""
    cached = replace(answer("claude-haiku-4-5"), input_tokens=1_000, output_tokens=0, cache_read=500, cache_written=100)
    price = TABLE.price_of(request(), cached)
    assert price == Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21", cache_read_usd=0.1, cache_write_usd=1.25)
    assert replace(cached, price=price).cost == pytest.approx((400 + 50 + 125) / 1e6)
    own = load(tmp_path, {"batch_factor": 0.5, "models": {"claude-haiku-4-5": ENTRY}})
    assert replace(cached, price=own.price_of(request(), cached)).cost is None
    plain = TABLE.price_of(request(), answer("claude-haiku-4-5"))
    assert plain == TABLE.price("claude-haiku-4-5", Delivery.direct)
