"""What tokens cost: a dated table, the price of one answer, and the most that a request can cost. Pure."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from tacevo.errors import ConfigError
from tacevo.records import Completion, Delivery, Json, Price, Request

#: Tokens that a provider adds to each turn for its role and its ends; more than any known tokeniser needs.
_TOKENS_PER_TURN = 64

#: Characters of English or code to a token, as a rule of thumb for estimates.
_CHARACTERS_PER_TOKEN = 4

#: The date at the end of a dated model name.
_DATE = re.compile(r"[-@](20\d{6}|20\d\d-\d\d-\d\d)$")


@dataclass(frozen=True, slots=True, kw_only=True)
class PriceTable:
    """The direct price of each model, and what a batch multiplies it by."""

    models: Mapping[str, Price]
    batch_factor: float
    #: The days, as `YYYY-MM-DD`, from which on providers no longer serve models, by name, as far as they are announced.
    retired: Mapping[str, str] = field(default_factory=dict)

    @property
    def offered(self) -> tuple[str, ...]:
        """The models that a provider can be asked for: not retired, nor soon, and not free, as the grammar is."""
        return tuple(name for name, price in self.models.items() if name not in self.retired and price.output_usd > 0)

    def retirement(self, model: str) -> str | None:
        """Look up when a model is retired, by its name or by its name without its date; None where nothing is known."""
        return self.retired.get(model) or self.retired.get(_DATE.sub("", model))

    def price(self, model: str, delivery: Delivery) -> Price | None:
        """Look a model up by its name, or by its name without its date; None where the table lacks it."""
        found = self.models.get(model) or self.models.get(_DATE.sub("", model))
        if found is None or delivery is Delivery.direct:
            return found
        return replace(found, factor=self.batch_factor)

    def price_of(self, request: Request, completion: Completion) -> Price | None:
        """Give the price of an answer: that of the model which answered, else of the one that was asked."""
        returned = self.price(completion.model, completion.delivery)
        return returned or self.price(request.model, completion.delivery)


def parse_prices(value: Json, name: str) -> PriceTable:
    """Read a price table.

    Args:
        value: `batch_factor`, and `models` with `input_usd`, `output_usd`, `dated`, `source` and perhaps `retired` by
            name.
        name: of the file, for messages.

    Raises:
        ConfigError: a field is missing, unknown or no sound number; the message names the model.
    """
    if not isinstance(value, dict) or set(value) != {"batch_factor", "models"} or not isinstance(value["models"], dict):
        raise ConfigError(f"llm.prices names {name}, which needs `batch_factor: NUMBER` and `models: ...`")
    if not _is_amount(value["batch_factor"]):
        raise ConfigError(f"llm.prices names {name}, whose batch_factor needs to be a number >= 0")
    models = {str(model): _parse_price(entry, f"{name}, whose {model}") for model, entry in value["models"].items()}
    retired = {str(model): str(entry["retired"]) for model, entry in value["models"].items() if "retired" in entry}
    return PriceTable(models=models, batch_factor=float(value["batch_factor"]), retired=retired)


def most_input_tokens(request: Request) -> int:
    """Bound the tokens of a request from above: no tokeniser makes more than one of a byte."""
    texts = [request.system, *(turn.content for turn in request.messages)]
    return sum(len(text.encode(errors="replace")) + _TOKENS_PER_TURN for text in texts)


def likely_tokens(text: str) -> int:
    """Estimate the tokens of a text, rounded up."""
    return -(-len(text) // _CHARACTERS_PER_TOKEN)


def worst_case(price: Price, request: Request) -> float:
    """Give the most that a request can cost, in US dollars: every byte a token, and an answer to the limit."""
    return price.cost(most_input_tokens(request), request.max_tokens)


def _parse_price(entry: Json, where: str) -> Price:
    if not isinstance(entry, dict) or {*entry} - {"retired"} != {"input_usd", "output_usd", "dated", "source"}:
        raise ConfigError(
            f"llm.prices names {where} needs input_usd, output_usd, dated, source, and takes retired; got {entry!r}"
        )
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", str(entry.get("retired", "2026-01-01"))):
        raise ConfigError(f"llm.prices names {where} needs a day like '2026-04-20' as retired; got {entry!r}")
    if not (_is_amount(entry["input_usd"]) and _is_amount(entry["output_usd"])):
        raise ConfigError(f"llm.prices names {where} needs dollars >= 0 for a million tokens; got {entry!r}")
    return Price(input_usd=float(entry["input_usd"]), output_usd=float(entry["output_usd"]), dated=str(entry["dated"]))


def _is_amount(value: Json) -> bool:
    return type(value) in (int, float) and 0 <= value < float("inf")
