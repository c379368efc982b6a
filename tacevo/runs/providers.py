"""The LLM of a run, built from its configuration: provider, budget and store, one before the other."""

import json
import logging
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from tacevo.choices import OPTIONAL_SAMPLING, Carrier
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
from tacevo.llm.capabilities import (
    BUDGETED,
    Capabilities,
    known_capabilities,
    recorded_capabilities,
    takes_temperature,
)
from tacevo.llm.described import DescribedLLM
from tacevo.llm.prices import PriceTable, line_to_add
from tacevo.llm.recording import RecordingLLM, temperature_taken
from tacevo.parts.kinds import PROVIDERS
from tacevo.parts.provider import Provider
from tacevo.records import Completion, Json, LongPrompts, Mode, Price, Request, Setting, to_json
from tacevo.redaction import names_place, without_password
from tacevo.storage.canonical import canonical, content_hash, leaves
from tacevo.storage.store import Store, Stores
from tacevo.text import counted, listed
from tacevo.typed import parse

_LOG = logging.getLogger(__name__)

#: The setting of what carries a temperature.
CARRIER = f"{TEMPERATURE}.carrier"

#: The kind of thinking that a user writes as a number.
_THINKING = {BUDGETED: "a number of tokens"}


@dataclass(slots=True)
class Begun:
    """Whether a run was begun without its temperature, because its model refuses it; such a run goes on so."""

    is_without: bool = False

    def note(self, completion: Completion) -> None:
        """Note an answer, recorded or new."""
        self.is_without |= TEMPERATURE in completion.dropped


def build_llm(config: RunConfig, mode: Mode, *, stores: Stores | None = None, begun: Begun | None = None) -> LLM:
    """Put the store before the provider, and the budget between them; in a replay there is no provider.

    In another mode than `replay` the completions follow `llm.mode`; without `stores` they are where the configuration
    says. Who begins the run says in `begun` whether it goes without its temperature.

    Raises:
        ConfigError: a key, an extra, a model or a price is missing.
    """
    llm, root = config.llm, Path(config.store.root)
    stores = stores or Stores(root)
    if mode is Mode.replay or llm.mode is Mode.replay:
        # It decides nothing in a replay, which reads it so that a bundle has it.
        for name in llm.names:
            recorded_capabilities(stores.of("models", Mode.replay), llm.provider, name)
        return RecordingLLM(None, stores.of("completions", Mode.replay))
    prices = prices_of(llm)
    provider: Provider = part_of(config, PROVIDERS, prices=prices)
    account, begun = Account(prices.price_of), begun or Begun()
    provider = _described(config, provider, stores.of("models", llm.mode), begun)
    if llm.budget_usd is not None:
        known = {name: _price(llm, name, prices) for name in llm.names}
        provider = BudgetedLLM(provider, account, limit=llm.budget_usd, prices=known)

    def note(request: Request, completion: Completion) -> None:
        begun.note(completion)
        if llm.budget_usd is not None:
            account.add(request, completion)

    return RecordingLLM(
        provider,
        stores.of("completions", llm.mode),
        price=prices.price_of,
        count=note,
        elsewhere=asks_elsewhere(llm),
        unlabelled=_unlabelled(llm),
    )


def _described(config: RunConfig, provider: Provider, store: Store, begun: Begun) -> Provider:
    """Let a hosted provider of ours be asked only once what its model takes has been checked."""
    llm = config.llm
    if not llm.facts.host:
        return provider

    def check(known: Mapping[str, Capabilities]) -> None:
        for name in llm.names:
            check_asked(config, name, known[name])
        if not begun.is_without:
            check_carrier(config)

    return DescribedLLM(
        provider,
        provider.models.catalogue,  # type: ignore[attr-defined]  # known only where its room is installed
        store=store,
        mode=llm.mode,
        provider=llm.provider,
        server=_other_server(llm),
        models={name: llm.model if llm.models is None else name for name in llm.names},
        check=check,
    )


def check_asked(config: RunConfig, model: str, known: Capabilities) -> None:
    """Check that a model takes what a run is to ask it for, before the first request; warn of one that ends.

    What is not known is learnt from what the server refuses.

    Raises:
        ConfigError: it does not take `llm.effort` or `llm.thinking`; the error names what it takes.
    """
    llm = config.llm
    if known.retires is not None:
        _LOG.warning("llm.model=%s is not served from %s on: choose another model", model, known.retires)
    kind = BUDGETED if isinstance(llm.thinking, int) or llm.thinking_tokens else llm.thinking
    kinds = None if known.thinkings is None else [_THINKING.get(each, each) for each in known.thinkings]
    key = "llm.thinking" if llm.thinking is not None else "llm.thinking_tokens"
    tokens = llm.thinking if isinstance(llm.thinking, int) else llm.thinking_tokens
    told = f"{tokens} tokens" if kind == BUDGETED else kind
    asked = (
        ("llm.effort", llm.effort, llm.effort, known.efforts),
        (key, kind and _THINKING.get(kind, kind), told, kinds),
    )
    for place, value, got, taken in asked:
        if value is not None and taken is not None and value not in taken:
            raise ConfigError(
                f"{got}, which {model} does not take",
                place=place,
                expected=f"{listed(taken)}, or null" if taken else "null",
                remedy="change the setting, or choose another llm.model",
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


def _other_server(llm: LLMConfig) -> str:
    """Name another server than the provider's own in records, which have no address: by a hash; else empty."""
    return content_hash(server_of(llm).rstrip("/"))[:16] if asks_elsewhere(llm) else ""


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
        usual = price.of_prompt(before.input_tokens / before.answers)
        each = usual.cost(before.input_tokens, before.output_tokens) / before.answers
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
    each: list[Price | LongPrompts] = [*known, *(price.long for price in known if price.long is not None)]
    inputs, outputs = max(price.input_usd for price in each), max(price.output_usd for price in each)
    return replace(known[0], input_usd=inputs, output_usd=outputs, long=None)


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
    """Check that a temperature reaches the model, if temperatures are compared, as far as the stores say.

    The overrides are what tells a search apart from those that it is compared with, among them its arm.

    Raises:
        ConfigError: they set a temperature, and nothing carries it: `temperature.carrier=none`, or the model refuses
            it.
    """
    choice, others = split_arm(overrides)
    of_arm = [key for key, _ in leaves(read_arm(choice)) if _is_of_temperature(key)]
    chosen = [each for each in others if _is_of_temperature(each.partition("=")[0])]
    settings = [*([f"{GROUP}={choice}"] if of_arm else []), *chosen]
    moved = [key for key in (*of_arm, *chosen) if key.partition("=")[0] != CARRIER]
    if moved and config.temperature.carrier is Carrier.none:
        raise ConfigError(
            f"{CARRIER}=none, with which this is the same search under another name",
            place=" ".join(settings),
            expected="a carrier of the temperature",
            remedy=f"leave the setting out, or set {CARRIER}=words, effort or parameter",
        )
    if settings:
        check_carrier(config, place=" ".join(settings), compares=True)


def _is_of_temperature(key: str) -> bool:
    return key.partition(".")[0] == TEMPERATURE


def check_carrier(config: RunConfig, *, place: str = f"{CARRIER}={Carrier.parameter}", compares: bool = False) -> None:
    """Check that what carries the temperature of a search can act on its model, as far as the stores say.

    An answer counts if it was given to the same model, token limit and settings. While a model thinks, no temperature
    is ever sent. `place` is the setting that an error about the temperature names. Of several models it is enough if
    one takes a temperature, but not where searches are to be compared (`compares`) that differ in it.

    Raises:
        ConfigError: the model refuses temperatures, or an effort.
        StoreError: what is recorded of the model is damaged.
    """
    llm, temperature = config.llm, config.temperature
    if not llm.facts.host or temperature.carrier in {Carrier.words, Carrier.none}:
        return
    settings = provider_settings(llm, config.own_settings(llm.provider))
    stores = Stores(Path(config.store.root))
    kinds = stores.of("models", Mode.replay), stores.of("completions", Mode.replay)
    server = _other_server(llm)
    models = {
        name: known_capabilities(*kinds, llm.provider, (name, llm.max_tokens, settings), server) for name in llm.names
    }
    refusals = [takes_temperature(known, settings) is False for known in models.values()]
    if temperature.carrier is Carrier.parameter and (any(refusals) if compares else all(refusals)):
        asked = llm.model if llm.models is None else llm.name
        others = "leave llm.thinking out" if llm.thinks else "choose another llm.model"
        raise ConfigError(
            f"llm.thinking={llm.thinking}; requests that let a model think have none"
            if llm.thinks
            else f"{asked}, which refuses temperatures",
            place=place,
            expected="a model that takes a temperature",
            remedy=f"set {CARRIER}=words (it chooses a sentence of the task's library), effort (it chooses the model's "
            f"effort) or none (nothing is sent), or {others}",
        )
    for name, known in models.items():
        taken = known.efforts
        lacking = [effort for effort in temperature.efforts if taken is not None and effort not in taken]
        if temperature.carrier is Carrier.effort and taken is not None and lacking:
            several = f"set temperature.efforts=[{','.join(taken)}]"
            raise ConfigError(
                f"{listed(lacking)}, which {name} does not take",
                place="temperature.efforts",
                expected=f"some of {listed(taken)}" if taken else "a model with efforts",
                remedy=several if len(taken) > 1 else f"set {CARRIER}=words or none",
            )


def answered_without(config: RunConfig) -> bool:
    """Answer whether recorded answers of a search's models came without the temperature that they were asked with."""
    llm = config.llm
    if not llm.facts.host:
        return False
    settings = provider_settings(llm, config.own_settings(llm.provider))
    store = Stores(Path(config.store.root)).of("completions", Mode.replay)
    return all(temperature_taken(store, (name, llm.max_tokens, settings)) is False for name in llm.names)


def provider_settings(llm: LLMConfig, own: Mapping[str, Json] | None = None) -> tuple[tuple[str, Setting], ...]:
    """Name what else an answer depends on, beside the request's own fields; what is not set is not named.

    `own` are the settings of a provider that is not ours: all of them are named.
    """
    if not llm.facts.is_model:
        slips: tuple[str, Setting] = ("slip_rate", llm.slip_rate)
        return (slips,) if llm.space is None else (slips, ("space", content_hash(to_json(llm.space))))
    chosen = {key: getattr(llm, key) for key in OPTIONAL_SAMPLING}
    sampling: dict[str, Setting] = {key: to_json(value) for key, value in chosen.items() if value}
    sampling = {key: tuple(value) if isinstance(value, list) else value for key, value in sampling.items()}
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
            remedy = f"add the line `{line_to_add(name)}` below `models:` of that table, {remedy}"
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
