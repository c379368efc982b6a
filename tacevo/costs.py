"""What answers cost, added up: for a candidate, a generation, a run or a store. Pure."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

from tacevo.records import Completion
from tacevo.text import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class Spending:
    """Answers and what was paid for them, by the prices recorded beside them."""

    answers: int = 0
    input_tokens: int = 0
    output_tokens: int = 0
    #: US dollars, of the answers that have a price.
    usd: float = 0.0
    #: Answers without a price.
    unpriced: int = 0


def spending_on(completions: Iterable[Completion]) -> Spending:
    """Add up what completions cost when they were recorded."""
    return total(_of_one(completion) for completion in completions)


def total(parts: Iterable[Spending]) -> Spending:
    """Add spendings up; the order does not matter, because dollars are summed exactly."""
    listed = tuple(parts)
    return Spending(
        answers=sum(part.answers for part in listed),
        input_tokens=sum(part.input_tokens for part in listed),
        output_tokens=sum(part.output_tokens for part in listed),
        usd=math.fsum(part.usd for part in listed),
        unpriced=sum(part.unpriced for part in listed),
    )


def in_words(spending: Spending) -> str:
    """Write a spending as a clause, e.g. `61 answers, 80,000 + 40,000 tokens, 0.0700 USD`."""
    tokens = f"{spending.input_tokens:,} + {spending.output_tokens:,} tokens"
    words = f"{counted(spending.answers, 'answer')}, {tokens}, {usd(spending)}"
    if 0 < spending.unpriced < spending.answers:
        words += f" without the {counted(spending.unpriced, 'answer')} of unknown price"
    return words


def usd(spending: Spending) -> str:
    """Write the dollars of a spending; `price unknown` where no answer has a price."""
    if spending.answers and spending.unpriced == spending.answers:
        return "price unknown"
    return f"{dollars(spending.usd)} USD"


def dollars(amount: float) -> str:
    """Write US dollars, 0 or more: to the cent from one dollar on, below it to three significant digits."""
    if amount >= 1 or amount == 0:
        return f"{amount:,.2f}"
    return f"{Decimal(f'{amount:#.3g}'):f}"  # an exponent, which :g writes below 0.0001, is hard to compare


def _of_one(completion: Completion) -> Spending:
    cost = completion.cost
    return Spending(
        answers=1,
        input_tokens=completion.input_tokens,
        output_tokens=completion.output_tokens,
        usd=cost or 0.0,
        unpriced=int(cost is None),
    )
