"""The prices of tokens: a dated table, the price of one answer, and the most that a request can cost. Pure."""

import json
import re
from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge
from pydantic import StringConstraints

from tacevo.records import Completion, Delivery, LongPrompts, Price, Record, Request, token_count

_Day = Annotated[str, StringConstraints(pattern=r"^\d{4}-\d\d-\d\d$")]

#: Tokens that a provider adds to each turn for its role and its ends; more than any known tokeniser needs.
_TOKENS_PER_TURN = 64

#: Characters of English or code to a token, as a rule of thumb for estimates.
CHARACTERS_PER_TOKEN = 4

#: The date at the end of a dated model name.
_DATE = re.compile(r"[-@](20\d{6}|20\d\d-\d\d-\d\d)$")


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedPrice(Record):
    """A model in the table: US dollars for a million tokens, with the day and the page where they were read."""

    input_usd: Annotated[float, Ge(0)]
    output_usd: Annotated[float, Ge(0)]
    dated: _Day
    source: str
    #: The day from which on the provider no longer serves the model; None where none is announced.
    retired: _Day | None = None
    #: What a request with a long prompt costs, where that is more.
    long: LongPrompts | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PriceTable(Record):
    """The direct price of each model, and what a batch and the provider's cache multiply it by."""

    models: dict[str, ListedPrice]
    batch_factor: Annotated[float, Ge(0)]
    #: The price of an input token that is read from the provider's cache, and of one that is written there, as parts of
    #: the input price; None where that is not known.
    cache_read_factor: Annotated[float, Ge(0)] | None = None
    cache_write_factor: Annotated[float, Ge(0)] | None = None

    @property
    def offered(self) -> tuple[str, ...]:
        """The models that a provider can be asked for: not retired, nor soon, and not free, as the grammar is."""
        return tuple(name for name, listed in self.models.items() if not listed.retired and listed.output_usd > 0)

    def retirement(self, model: str) -> str | None:
        """Return when a model is retired; None where that is not known."""
        listed = self._listed(model)
        return None if listed is None else listed.retired

    def price(self, model: str, delivery: Delivery) -> Price | None:
        """Return a model's price; None where the table lacks it."""
        listed = self._listed(model)
        if listed is None:
            return None
        factor = 1.0 if delivery is Delivery.direct else self.batch_factor
        usd = {"input_usd": listed.input_usd, "output_usd": listed.output_usd}
        return Price(**usd, dated=listed.dated, factor=factor, long=listed.long)

    def _listed(self, model: str) -> ListedPrice | None:
        """Look a model up by its name, or by its name without its date."""
        return self.models.get(model) or self.models.get(_DATE.sub("", model))

    def price_of(self, request: Request, completion: Completion) -> Price | None:
        """Return the price of an answer: that of the model which answered, else of the one that was asked.

        Where the tokens of its prompt are not known, it has as many as it may have.
        """
        listed = self.price(completion.model, completion.delivery) or self.price(request.model, completion.delivery)
        if listed is None:
            return None
        prompt = token_count(completion.input_tokens)
        price = listed.of_prompt(most_input_tokens(request) if prompt is None else prompt)
        if (completion.cache_read, completion.cache_written) == (0, 0):
            return price
        read, write = self.cache_read_factor, self.cache_write_factor
        return replace(
            price,
            cache_read_usd=None if read is None else read * price.input_usd,
            cache_write_usd=None if write is None else write * price.input_usd,
        )


def most_input_tokens(request: Request) -> int:
    """Bound the tokens of a request from above: no tokeniser makes more than one of a byte."""
    texts = [request.system, *(turn.content for turn in request.messages)]
    return sum(len(text.encode(errors="replace")) + _TOKENS_PER_TURN for text in texts)


def likely_tokens(text: str) -> int:
    """Estimate the tokens of a text, rounded up."""
    return -(-len(text) // CHARACTERS_PER_TOKEN)


def line_to_add(model: str) -> str:
    """Write the line that a price table lacks, for the user to fill in."""
    name = model if re.fullmatch(r"[A-Za-z][\w./-]*", model) else json.dumps(model)
    return f'{name}: {{input_usd: X, output_usd: Y, dated: "YYYY-MM-DD", source: PAGE}}'


def worst_case(price: Price, request: Request) -> float:
    """Return the most that a request can cost, in US dollars: every byte a token, and an answer to the limit."""
    tokens = most_input_tokens(request)
    return price.of_prompt(tokens).cost(tokens, request.max_tokens)
