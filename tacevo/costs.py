"""The costs of answers, added up: for a candidate, a generation, a run or a store. Pure."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

from tacevo.records import Completion
from tacevo.text import counted

_UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spending:
    """Answers and what was paid for them, by the prices recorded beside them."""

    answers: int = 0
    input_tokens: int = 0
    output_tokens: int = 0
    #: US dollars, of the answers whose cost is known.
    usd: float = 0.0
    #: Answers whose cost is not known.
    unpriced: int = 0
    #: Answers whose tokens are not known, and not in the sums.
    uncounted: int = 0

    @property
    def tokens(self) -> int | None:
        """Input and output tokens together; None where those of an answer are not known."""
        return None if self.uncounted else self.input_tokens + self.output_tokens


@dataclass(slots=True)
class Tally:
    """The answers that a search got while it ran: from the model, which are paid now, and from the store."""

    asked: Spending = Spending()
    recalled: int = 0

    @property
    def in_words(self) -> str:
        """Write it as a clause, e.g. `3 asked, 6 from the store, 0.0200 USD`; empty where nothing was answered."""
        if not (self.asked.answers or self.recalled):
            return ""
        return f"{self.asked.answers} asked, {self.recalled} from the store, {paid(self.asked)}"


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
        uncounted=sum(part.uncounted for part in listed),
    )


def in_words(spending: Spending) -> str:
    """Write a spending as a clause, e.g. `61 answers, 80,000 + 40,000 tokens, 0.0700 USD`."""
    read, written = token_cells(spending)
    tokens = "tokens unknown" if read == _UNKNOWN else f"{read} + {written} tokens"
    words = f"{counted(spending.answers, 'answer')}, {tokens}, {paid(spending)}"
    if 0 < spending.uncounted < spending.answers:
        words += f", and without the tokens of {counted(spending.uncounted, 'answer')}"
    return words


def paid(spending: Spending) -> str:
    """Write the dollars of a spending, and which answers they leave out."""
    known = usd(spending)
    if 0 < spending.unpriced < spending.answers:
        known += f" without the {counted(spending.unpriced, 'answer')} of unknown price"
    return known


def token_cells(spending: Spending) -> tuple[str, str]:
    """Write the input and the output tokens of a spending; `unknown` where those of no answer are known."""
    if spending.answers and spending.uncounted == spending.answers:
        return _UNKNOWN, _UNKNOWN
    return f"{spending.input_tokens:,}", f"{spending.output_tokens:,}"


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
    cost, tokens = completion.cost, completion.tokens
    read, written = tokens or (0, 0)
    return Spending(
        answers=1,
        input_tokens=read,
        output_tokens=written,
        usd=cost or 0.0,
        unpriced=int(cost is None),
        uncounted=int(tokens is None),
    )
