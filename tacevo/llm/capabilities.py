"""What a model takes: temperature, efforts, kinds of thinking; from what its server tells, and what it answered. Pure.

The Models API tells efforts and kinds of thinking; of a temperature it says nothing. What is not told is unknown, and
learnt from what a server refuses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import ClassVar, Protocol

from tacevo.choices import Effort, Thinking
from tacevo.errors import StoreError
from tacevo.llm.recording import Choice, temperature_taken
from tacevo.records import Json, Record, Setting
from tacevo.storage.store import Store
from tacevo.typed import convert

#: The kind of thinking with a number of tokens, as the Messages API calls it.
BUDGETED = "enabled"

#: All kinds of thinking.
THINKINGS = (Thinking.adaptive.value, Thinking.disabled.value, BUDGETED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Capabilities(Record):
    """What is known of a model; None for what is not."""

    #: Whether it takes a temperature, where it is not asked to think.
    temperature: bool | None = None
    #: The efforts that it takes, from the least to the most; none where it does not know the setting.
    efforts: tuple[Effort, ...] | None = None
    #: The kinds of thinking that it takes, of `THINKINGS`.
    thinkings: tuple[str, ...] | None = None
    #: The day from which on it is not served any more, as `YYYY-MM-DD`.
    retires: str | None = None

    #: What no server tells is in no store.
    LATER: ClassVar[frozenset[str]] = frozenset({"temperature"})


class Catalogue(Protocol):
    """What a provider knows of its models beside their answers."""

    def ask(self, model: str) -> Json:
        """Ask a server what a model takes, once; None where it does not say, for whatever reason."""
        ...

    def end(self, model: str) -> str | None:
        """Return the day from which on a model is not served any more, as `YYYY-MM-DD`; None where none is known."""
        ...


def read_capabilities(told: Json) -> Capabilities:
    """Read what the Models API answers about a model; what is missing, or no answer of that API, is unknown.

    Nothing that is not known beforehand is taken over, so no text of a server gets into a store or a message.
    """
    capabilities = _part(told, "capabilities")
    effort, thinking = _part(capabilities, "effort"), _part(capabilities, "thinking")
    # Thinking may be turned off on a model that has none, so its `supported` says nothing of its types.
    thinkings = _supported(_part(thinking, "types"), THINKINGS)
    efforts = () if effort.get("supported") is False else _supported(effort, tuple(Effort))
    return _with_temperature(
        Capabilities(
            efforts=None if efforts is None else tuple(map(Effort, efforts)),
            thinkings=thinkings,
            retires=_day(_mapping(told).get("retires_at")),
        )
    )


def _with_temperature(told: Capabilities) -> Capabilities:
    """Add what follows of the temperature, which no server tells.

    A model that thinks adaptively, and takes no number of tokens to think with, takes none: so it is with every such
    model, by their documentation.
    """
    kinds = told.thinkings or ()
    return replace(told, temperature=False) if Thinking.adaptive in kinds and BUDGETED not in kinds else told


def question(provider: str, model: str, server: str = "") -> Json:
    """Return the request under which the store `models` has what a provider told of a model.

    `server` names another server than the provider's own, which may know another model by that name.
    """
    return {"provider": provider, "model": model} | ({"server": server} if server else {})


def recorded_capabilities(store: Store, provider: str, model: str, server: str | None = None) -> Capabilities | None:
    """Return what a server told of a model in this run or an earlier one, whatever the mode; None where nothing is.

    Without `server`, as in a replay, which asks none and may not know the address: of the provider's own, or else of
    any other.

    Raises:
        StoreError: the entry is damaged.
    """
    asked = question(provider, model, server or "")
    told = store.read(asked)
    if told is None and server is None:
        for entry in store.sound():
            other = str(_mapping(entry.request).get("server", ""))
            if told is None and entry.request == question(provider, model, other):
                asked, told = entry.request, store.read(entry.request)
    if told is None:
        return None
    place = f"{store.path(store.key(asked))}, answer"
    return _with_temperature(convert(Capabilities, told, place=place, error=StoreError, remedy="delete that file"))


def known_capabilities(
    models: Store, completions: Store, provider: str, chosen: Choice, server: str | None = None
) -> Capabilities:
    """Return what is known of a model, by what its server told and by how it answered requests of this choice.

    Answers weigh more than what follows from the Models API: where one was given with a temperature, it takes one.
    `server` is as of `recorded_capabilities`.

    Raises:
        StoreError: the entry of the model is damaged.
    """
    told = recorded_capabilities(models, provider, chosen[0], server) or Capabilities()
    taken = temperature_taken(completions, chosen)
    return told if taken is None else replace(told, temperature=taken)


def thinks(settings: tuple[tuple[str, Setting], ...]) -> bool:
    """Answer whether `llm.thinking` asks the model to think; then the Messages API takes no temperature.

    Requests with its older name `thinking_tokens` are sent as they always were: with one, and then without.
    """
    return dict(settings).get("thinking", Thinking.disabled) != Thinking.disabled


def takes_temperature(known: Capabilities, settings: tuple[tuple[str, Setting], ...]) -> bool | None:
    """Answer whether requests with such settings can have a temperature; None where that is not known."""
    return False if thinks(settings) else known.temperature


def _mapping(value: Json) -> Mapping[str, Json]:
    return value if isinstance(value, Mapping) else {}


def _part(value: Json, name: str) -> Mapping[str, Json]:
    return _mapping(_mapping(value).get(name))


def _supported(kinds: Mapping[str, Json], names: Sequence[str]) -> tuple[str, ...] | None:
    """Return the kinds that are told to be supported; None where none is told to be so or not."""
    told = {name: _part(kinds, name).get("supported") for name in names}
    if not any(isinstance(each, bool) for each in told.values()):
        return None
    return tuple(name for name in names if told[name] is True)


def _day(value: Json) -> str | None:
    """Read the day at the beginning of a time, as `YYYY-MM-DD`."""
    try:
        return datetime.fromisoformat(value).date().isoformat() if isinstance(value, str) else None
    except ValueError:
        return None
