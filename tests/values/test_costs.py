"""Promise: costs are added up from the prices recorded beside the answers; an unknown price is said to be unknown."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.costs import Spending, dollars, in_words, spending_on, total, usd
from tacevo.records import Completion, Price

HAIKU = Price(input_usd=0.25, output_usd=1.25, dated="2026-11-21")

SPENDINGS = st.builds(
    Spending,
    answers=st.integers(0, 10),
    input_tokens=st.integers(0, 10**6),
    output_tokens=st.integers(0, 10**6),
    usd=st.floats(0, 1e3),
    unpriced=st.integers(0, 10),
)


def answer(price: Price | None) -> Completion:
    """Make an answer of a million input and two million output tokens."""
    free = Completion(text="", model="m", stop_reason="", input_tokens=1_000_000, output_tokens=2_000_000)
    return replace(free, price=price)


def test_cost_is_tokens_times_price() -> None:
    """A million tokens in and two million out, by hand: 0.25 + 2 * 1.25 dollars; of a batch, half of both."""
    assert answer(HAIKU).cost == 0.25 + 2 * 1.25
    assert answer(replace(HAIKU, factor=0.5)).cost == (0.25 + 2 * 1.25) / 2


def test_answers_without_price_are_counted_apart() -> None:
    """Their tokens count, their dollars are not taken for zero."""
    spent = spending_on([answer(HAIKU), answer(None)])
    assert spent == Spending(answers=2, input_tokens=2_000_000, output_tokens=4_000_000, usd=2.75, unpriced=1)
    assert in_words(spent).endswith("2.75 USD without the 1 answer of unknown price")
    assert usd(spending_on([answer(None)])) == "price unknown"
    assert in_words(spending_on([answer(None)])) == "1 answer, 1,000,000 + 2,000,000 tokens, price unknown"


def test_nothing_costs_nothing() -> None:
    """Without an answer the cost is 0, not unknown."""
    assert usd(total([])) == "0.00 USD"


@pytest.mark.parametrize(
    ("amount", "shown"),
    [
        (0.0, "0.00"),
        (1234.567, "1,234.57"),
        (1.0, "1.00"),
        (0.9996, "1.00"),
        (0.5, "0.500"),
        (0.07, "0.0700"),
        (0.000195, "0.000195"),
        (2.5e-7, "0.000000250"),
    ],
)
def test_dollars_have_cents_where_large_and_three_digits_where_small(amount: float, shown: str) -> None:
    """From one dollar on to the cent, below it three significant digits and no exponent."""
    assert dollars(amount) == shown


@given(st.lists(SPENDINGS, max_size=6), st.randoms(use_true_random=False))
def test_order_changes_no_total(parts: list[Spending], shuffler: object) -> None:
    """Dollars are summed exactly, so that a resumed or parallel run adds up to the same."""
    shuffled = list(parts)
    shuffler.shuffle(shuffled)  # type: ignore[attr-defined]
    assert total(shuffled) == total(parts)


def test_unknown_tokens_are_in_no_sum() -> None:
    """A part whose tokens are known is shown with what it lacks; where none is known, nothing is."""
    known = Spending(answers=2, input_tokens=10, output_tokens=20, usd=1.0)
    unknown = Spending(answers=1, unpriced=1, uncounted=1)
    both = total([known, unknown])
    assert (both.tokens, known.tokens) == (None, 30)
    assert "10 + 20 tokens" in in_words(both)
    assert in_words(both).endswith("and without the tokens of 1 answer")
    assert in_words(unknown) == "1 answer, tokens unknown, price unknown"
