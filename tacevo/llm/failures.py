"""The failures of every provider: what a run learns of its models, and what becomes of requests without an answer."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Set
from dataclasses import dataclass, field, replace

from tacevo.errors import ConfigError, TransportError
from tacevo.llm.capabilities import Catalogue, thinks
from tacevo.llm.prices import PriceTable
from tacevo.llm.recording import Choice, choice
from tacevo.llm.retry import DOUBTED, Fault, FaultKind, refused_setting, setting_to_drop
from tacevo.llm.stops import UNKNOWN
from tacevo.records import Completion, Delivery, Request
from tacevo.redaction import repeats_secret, without_secrets
from tacevo.text import listed

_LOG = logging.getLogger(__name__)

#: The stop reason of an answer that repeats the key, in the place of its own.
KEY_REPEATED = "key_repeated"

#: What is said where a temperature is not sent because of thinking.
_NO_TEMPERATURE = (
    "temperature is not sent, because the API takes none while a model thinks (llm.thinking); so the temperature rule "
    "has no effect"
)

#: The number of models that a message names of those that a server lists.
_MOST_NAMES = 20


class Models:
    """Remembers, for a run, what its models are called, which settings they refuse, which of them answer, and when.

    It also reports failed tries that are repeated, once for each kind (a status, an exception), and what answers lack.

    Args:
        name: what the user chose, for messages, e.g. `llm=anthropic`.
        recorded: tells whether an earlier run had an answer to a request with the same model, token limit and settings;
            asked only where that matters. None where nothing is recorded.
        prices: whose models a user may choose instead of one that the server lacks; None where it is not about this
            provider.
        unlabelled: what the server calls the model, where requests have a label in its place; else None.
        catalogue: tells what the models take; None where nothing does.
    """

    def __init__(
        self,
        name: str,
        recorded: Callable[[Request], bool] | None = None,
        *,
        prices: PriceTable | None = None,
        unlabelled: str | None = None,
        catalogue: Catalogue | None = None,
    ) -> None:
        self.name = name
        self.catalogue = catalogue
        self._recorded = recorded
        self._prices = prices
        self._unlabelled = unlabelled
        #: Whether anything ever came from a server, be it a refusal.
        self.heard = False
        #: The models that the server lists, once it was asked for them.
        self.served: tuple[str, ...] = ()
        self._dropped: dict[str, tuple[str, ...]] = {}
        self._answers: dict[Choice, bool] = {}
        #: The time when the latest request that a model answered was sent, by the model.
        self._answered: dict[str, float] = {}
        self._reported: set[str] = set()

    def sent(self, request: Request) -> Request:
        """Return a request as the server gets it."""
        return request if self._unlabelled is None else replace(request, model=self._unlabelled)

    def dropped(self, request: Request) -> tuple[str, ...]:
        """Return the sampling settings that a request is sent without, sorted: its model or its thinking takes none."""
        refused = self._dropped.get(request.model, ())
        if request.temperature is None or not thinks(request.settings) or "temperature" in refused:
            return refused
        self._warn_once("thinking", f"{_NO_TEMPERATURE} (reported once)")
        return tuple(sorted({*refused, "temperature"}))

    def is_doubted(self, request: Request) -> bool:
        """Answer whether a request has settings that many models refuse, and none with these was answered in this run.

        What the Models API tells does not settle it: a model may take an effort and a thinking, and not both together.
        """
        return bool(DOUBTED & dict(request.settings).keys()) and not self._answers.get(choice(request), False)

    def refused(self, request: Request, fault: Fault) -> str | None:
        """Return which setting a refusal is about that is not dropped; None where it is about none."""
        said = fault.message.replace(self.sent(request).model, "")  # whose name may be a setting's
        return refused_setting(replace(fault, message=said), {"max_tokens", *dict(request.settings)})

    def refuses_choice(self, request: Request, fault: Fault) -> bool:
        """Answer whether a refusal is of a setting that many models refuse, hence of all requests of its choice."""
        return self.refused(request, fault) in DOUBTED and not self.answers(request)

    def learn(self, request: Request, sent: Set[str], fault: Fault) -> bool:
        """Learn from a refusal of what was sent with some settings; return whether to try again without one of them."""
        name = setting_to_drop(fault, sent)
        if name is not None:
            self._dropped[request.model] = tuple(sorted({*self._dropped.get(request.model, ()), name}))
        return name is not None

    def lacking(self, model: str, said: str) -> ConfigError:
        """Return the error about a model that the server lacks; it names the models that there are."""
        retired = None if self._prices is None else self._prices.retirement(model)
        offered = () if self._prices is None else self._prices.offered
        whose, names = ("llm.prices", offered) if offered and not self.served else ("the server", self.served)
        since = f", which was retired on {retired}" if retired else ""
        expected = f"a model that {whose} has" + (f" ({listed(names, most=_MOST_NAMES)})" if names else "")
        return ConfigError(f"{model}{since} (the server says: {said})", place="llm.model", expected=expected)

    def note_answer(self, request: Request, completion: Completion, begun: float) -> None:
        """Note that a model answers a request that was sent at a time of `time.monotonic`; report what answers lack."""
        unknown = {
            "which model they are of": not completion.model,
            "how many tokens they took, so what they cost is unknown": completion.tokens is None,
            "by a known word why they ended, so they count as possibly cut off": completion.stop_reason == UNKNOWN,
        }
        for what, is_so in unknown.items():
            if is_so:
                self._warn_once(what, f"answers do not tell {what} (reported once)")
        self.heard = True
        self._answers[choice(request)] = True
        self._answered[request.model] = max(self._answered.get(request.model, begun), begun)

    def without_key(self, completion: Completion, secrets: tuple[str, ...]) -> Completion:
        """Return an answer as it came; where it repeats the key, one that says so, without a text.

        Stores are published, and to black the key out would make another text of the answer.
        """
        if not repeats_secret(f"{completion.text}\n{completion.model}", secrets):
            return completion
        self._warn_once("key", "an answer repeats the API key, so it is rejected and its text is not recorded")
        return replace(completion, text="", model=without_secrets(completion.model, secrets), stop_reason=KEY_REPEATED)

    def answers(self, request: Request) -> bool:
        """Return whether such a request was ever answered, in this run or in one that recorded it."""
        chosen = choice(request)
        if chosen not in self._answers:
            self._answers[chosen] = self._recorded is not None and self._recorded(request)
        return self._answers[chosen]

    def answered_since(self, request: Request, refused: float) -> bool:
        """Return whether a request's model answered another one that was sent after this one was refused."""
        return self._answered.get(request.model, refused) > refused

    def report(self, fault: Fault, wait: float) -> None:
        """Report a fault, which holds no secrets, and the seconds until the next try; each kind of fault once."""
        words = f"{fault.message}; asking again in {wait:.1f} s (reported once for each kind of fault)"
        self._warn_once(fault.message.partition(":")[0], words)

    def _warn_once(self, kind: str, words: str) -> None:
        if kind not in self._reported:
            self._reported.add(kind)
            _LOG.warning("%s: %s", self.name, words)


@dataclass(slots=True, kw_only=True)
class Failures:
    """The requests of one round that got no answer, as (position, request, fault)."""

    models: Models
    delivery: Delivery = Delivery.direct
    _all: list[tuple[int, Request, Fault]] = field(default_factory=list)

    def add(self, position: int, request: Request, fault: Fault) -> None:
        """Note a failure."""
        self._all.append((position, request, fault))

    @property
    def hopeless(self) -> bool:
        """Whether nothing further should begin."""
        return any(fault.hopeless or self.models.refuses_choice(request, fault) for _, request, fault in self._all)

    def recorded(self) -> list[tuple[int, Completion]]:
        """Return completions in place of the requests that can never be answered, so that they stop no run.

        Where no such request was ever answered, the settings are at fault. A doubtful refusal is about its request
        where the model answered another one after it, or where no other request got the same words; else it may be
        about the account, and would be recorded for every request that follows.
        """
        return [
            (
                position,
                Completion(
                    text="",
                    model=request.model,
                    stop_reason=fault.stop_reason,
                    input_tokens=0,
                    output_tokens=0,
                    dropped=self.models.dropped(request),
                    delivery=self.delivery,
                ),
            )
            for position, request, fault in self._all
            if self._is_about_the_request(request, fault)
        ]

    def raise_rest(self, requests: int) -> None:
        """Raise what remains of the failures of a round of so many requests.

        Raises:
            ConfigError: the key, the model, a setting or the payment is refused; asking again cannot help.
            TransportError: requests failed after all tries.
        """
        for _, request, fault in self._all:
            if fault.kind is FaultKind.unknown:
                raise self.models.lacking(self.models.sent(request).model, fault.message)
        rest = [fault for _, request, fault in self._all if not self._is_about_the_request(request, fault)]
        passing = [fault for fault in rest if fault.kind is FaultKind.passing]
        final = next((fault for fault in rest if fault.kind is not FaultKind.passing), None)
        for _, request, fault in self._all:
            if not self._is_about_the_request(request, fault) and (name := self.models.refused(request, fault)):
                raise _refusal(name, request, fault)
        if final is not None:
            raise ConfigError(f"the server says: {final.message}", place=self.models.name, remedy=final.remedy)
        if passing:
            got = f"{len(passing)} of {requests} requests failed after all tries, the first with {passing[0].message}"
            remedy = "repeat the same command: the answers that came are recorded"
            if passing[0].silent:
                remedy = "start the server, or check llm.base_url; then repeat the same command"
            raise TransportError(got, place=self.models.name, remedy=remedy)

    def _is_about_the_request(self, request: Request, fault: Fault) -> bool:
        if fault.kind not in {FaultKind.request, FaultKind.doubtful} or not self.models.answers(request):
            return False
        if fault.kind is FaultKind.request or self.models.answered_since(request, fault.at):
            return True
        return Counter(other.message for _, _, other in self._all)[fault.message] == 1


def settings_of(request: Request, always: Iterable[str]) -> set[str]:
    """Return the names of the settings that a request is sent with: its own, and those that every request has.

    A temperature that is carried otherwise is not among them.
    """
    lacking = {"temperature"} if request.temperature is None else set()
    return {*always, *dict(request.settings)} - lacking


def _refusal(name: str, request: Request, fault: Fault) -> ConfigError:
    """Return the error about a setting that a server refuses; it names the setting as the user writes it."""
    value = dict(request.settings).get(name, request.max_tokens)
    shown = list(value) if isinstance(value, tuple) else value
    by_temperature = name == "effort" and request.temperature is None
    chosen = "; where temperature.carrier=effort chose it: set temperature.efforts" if by_temperature else ""
    return ConfigError(
        f"{shown}, which {request.model} refuses: {fault.message}",
        place=f"llm.{name}",
        expected="a value that the model takes",
        remedy=f"choose another value, leave llm.{name} out, or choose another llm.model{chosen}",
    )


def check_key(key: str, variable: str) -> None:
    """Reject a key that cannot be sent as it is: a client would alter it, or fail at every request.

    Raises:
        ConfigError: it holds a blank, a control character or one that is not ASCII.
    """
    if not key.isascii() or not key.isprintable() or " " in key:
        got, remedy = "a blank, a line break or another character that keys do not have", "set it again"
        raise ConfigError(got, place=variable, expected="an API key", remedy=remedy)
