"""The LLM of a run, built from its configuration: provider, budget and store, one before the other."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from tacevo.choices import OPTIONAL_SAMPLING
from tacevo.config.arms import GROUP, read_arm, split_arm
from tacevo.config.chosen import part_of
from tacevo.config.conf_folder import config_file, read_named
from tacevo.config.schema import LLMConfig, RunConfig
from tacevo.config.strict_yaml import read_yaml
from tacevo.costs import Spending, dollars
from tacevo.errors import ConfigError
from tacevo.evolution.development import LLM
from tacevo.evolution.lines import TEMPERATURE
from tacevo.llm.budget import Account, BudgetedLLM
from tacevo.llm.prices import PriceTable
from tacevo.llm.recording import RecordingLLM, ever_refused, unkept
from tacevo.parts.kinds import PROVIDERS
from tacevo.parts.provider import Provider
from tacevo.records import Json, Mode, Price, Setting, to_json
from tacevo.redaction import names_place, without_password
from tacevo.storage.canonical import canonical, content_hash
from tacevo.storage.store import Store, Stores
from tacevo.text import counted
from tacevo.typed import parse


def build_llm(config: RunConfig, mode: Mode, *, stores: Stores | None = None) -> LLM:
    """Put the store before the provider, and the budget between them; in a replay there is no provider.

    In another mode than `replay` the completions follow `llm.mode`; without `stores` they are where the configuration
    says.

    Raises:
        ConfigError: a key, an extra, a model or a price is missing.
    """
    llm, root = config.llm, Path(config.store.root)
    stores = stores or Stores(root)
    if mode is Mode.replay or llm.mode is Mode.replay:
        return RecordingLLM(None, stores.of("completions", Mode.replay))
    prices = prices_of(llm)
    provider: Provider = part_of(config, PROVIDERS, prices=prices)
    account = Account(prices.price_of)
    if llm.budget_usd is not None:
        known = {name: _price(llm, name, prices) for name in llm.names}
        provider = BudgetedLLM(provider, account, limit=llm.budget_usd, price=known[llm.names[0]], prices=known)
    return RecordingLLM(
        provider,
        stores.of("completions", llm.mode),
        price=prices.price_of,
        count=unkept if llm.budget_usd is None else account.add,
        elsewhere=asks_elsewhere(llm),
        unlabelled=_unlabelled(llm),
    )


def asks_elsewhere(llm: LLMConfig) -> bool:
    """Return whether another server than the provider's own is asked, by llm.base_url or as its SDK was told."""
    if not llm.facts.host:
        return False
    address = llm.base_url or os.environ.get(llm.facts.variable)
    return (
        bool(address) and re.match(rf"https://([\w-]+\.)*{re.escape(llm.facts.host)}(:\d+)?(/|$)", str(address)) is None
    )


def server_of(llm: LLMConfig) -> str:
    """Return where a hosted model is asked: an address without its password, or the host of the provider's own."""
    return without_password(llm.base_url or os.environ.get(llm.facts.variable) or llm.facts.host)


def asked_next(llm: LLMConfig, *, requests: int, before: Spending, elsewhere: bool) -> list[str]:
    """Say whom the next requests of a run go to, and what may be paid; nothing where no server is asked.

    Args:
        llm: of the run as it goes on.
        requests: how many there are, at most.
        before: what the answers so far cost; those that come are taken to be as long.
        elsewhere: whether another server than the provider's own gave these.
    """
    if not llm.facts.host or llm.mode is Mode.replay:
        return []
    others = elsewhere and not asks_elsewhere(llm)
    own = ", the provider's own and not the server that answered so far (llm.base_url=URL names that)" if others else ""
    table = prices_of(llm)
    price = dearest([table.price(name, llm.delivery) for name in llm.names])
    if price is None:
        paid = "what they cost is not known"
    elif before.uncounted or not before.answers:
        paid = f"an answer to the limit of {counted(llm.max_tokens, 'token')} alone is "
        paid += f"{dollars(price.cost(0, llm.max_tokens))} USD"
    else:
        each = price.cost(before.input_tokens, before.output_tokens) / before.answers
        paid = f"some {dollars(requests * each)} USD, if answers are as long as those so far"
    limit = (
        "no limit (llm.budget_usd=N sets one)" if llm.budget_usd is None else f"at most {llm.budget_usd:g} USD in all"
    )
    return [
        f"asking {llm.name} at {server_of(llm)}{own}",
        f"up to {counted(requests, 'request')}: {paid}; {limit}",
    ]


def dearest(prices: Sequence[Price | None]) -> Price | None:
    """Return a price above which no model of several costs, as far as one is known of each; else None."""
    known = [price for price in prices if price is not None]
    if len(known) < len(prices):
        return None
    inputs, outputs = max(price.input_usd for price in known), max(price.output_usd for price in known)
    return replace(known[0], input_usd=inputs, output_usd=outputs)


def name_warning(llm: LLMConfig) -> str | None:
    """Say what is wrong with the model's name for a run that may be published; None where nothing is."""
    if llm.models is not None or not names_place(llm.name):
        return None
    return (
        f"llm.model={llm.model} is a path, and stands wherever the model is named; set llm.label=NAME, without which "
        "the run cannot be published"
    )


def _unlabelled(llm: LLMConfig) -> str | None:
    return None if llm.label is None else llm.model


def check_temperature(overrides: Sequence[str], config: RunConfig) -> None:
    """Check that the model takes a temperature, if temperatures are compared, as far as the recorded answers say.

    The overrides are what tells a search apart from those that it is compared with, among them its arm. An answer
    counts if it was given to the same model, token limit and settings.

    Raises:
        ConfigError: they set a temperature, and the model refuses it.
    """
    choice, others = split_arm(overrides)
    settings = [f"{GROUP}={choice}"] if TEMPERATURE in read_arm(choice) else []
    settings += [override for override in others if override.partition("=")[0].partition(".")[0] == TEMPERATURE]
    llm = config.llm
    more = llm.max_tokens, provider_settings(llm, config.own_settings(llm.provider))
    store = Store(Path(config.store.root), "completions")
    # Where one of several models takes a temperature, the temperatures are not in vain.
    if settings and all(ever_refused(store, (name, *more), TEMPERATURE) for name in llm.names):
        name = llm.model if llm.models is None else llm.name
        raise ConfigError(
            f"{name}, which refuses temperatures: its answers in {config.store.root} were given without",
            place=" ".join(settings),
            expected="a model that takes a temperature",
            remedy="leave the setting out, or choose another llm.model",
        )


def provider_settings(llm: LLMConfig, own: Mapping[str, Json] | None = None) -> tuple[tuple[str, Setting], ...]:
    """Name what else an answer depends on, beside the request's own fields; what is not set is not named.

    `own` are the settings of a provider that is not ours: all of them are named.
    """
    if not llm.facts.is_model:
        slips: tuple[str, Setting] = ("slip_rate", llm.slip_rate)
        return (slips,) if llm.space is None else (slips, ("space", content_hash(to_json(llm.space))))
    chosen = {key: getattr(llm, key) for key in OPTIONAL_SAMPLING}
    sampling = {key: tuple(value) if isinstance(value, list) else value for key, value in chosen.items() if value}
    more = {name: canonical(value) for name, value in (own or {}).items()}
    return tuple(sorted((sampling | more).items()))


def _price(llm: LLMConfig, name: str, prices: PriceTable) -> Price:
    """Price a model that a budget is for."""
    price = prices.price(name, llm.delivery)
    if price is None:
        got, remedy = f"{name} without a price in {llm.prices}", "name your own by llm.prices=FILE"
        if asks_elsewhere(llm):
            got += ", which is not about other servers"
        else:
            remedy = f"add the model to that table, {remedy}"
        raise ConfigError(
            got,
            place="llm.budget_usd",
            expected="a model of known price",
            remedy=f"{remedy}, or set llm.budget_usd=null",
        )
    return price


def prices_of(llm: LLMConfig) -> PriceTable:
    """Read the prices of what a run asks: of another server than the provider's own, only those that the user gives.

    Raises:
        ConfigError: as `load_prices`.
    """
    prices = load_prices(llm.prices)
    return replace(prices, models={}) if asks_elsewhere(llm) and llm.prices == LLMConfig.prices else prices


def load_prices(name: str) -> PriceTable:
    """Read a price table, absolute or below conf/; `compose` makes one absolute that lies in the working directory.

    Raises:
        ConfigError: the file is missing or malformed.
    """
    place = f"llm.prices={name}"
    if not config_file(name, "llm.prices").is_file():
        expected = "a price table, in the working directory or below conf/"
        raise ConfigError(f"{name}, which is not there", place=place, expected=expected)
    try:
        table = json.dumps(read_yaml(read_named("llm.prices", name)), default=str)  # YAML reads days as dates
    except yaml.YAMLError as error:
        raise ConfigError(str(error), place=place, expected="YAML") from error
    return parse(PriceTable, table, place=place, error=ConfigError)
