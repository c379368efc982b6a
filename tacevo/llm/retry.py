"""The faults between a request and its answer, and what follows from each; the same for every provider.

    passing    rate limit, overload, time-out, server error, lost connection, unreadable or failed answer: asked again
    request    this request can never be answered (too long, filtered): recorded as an answer without text
    doubtful   refused, for this request or for every one: `tacevo.llm.failures` decides
    unknown    the server has no such model: the run stops, and names the models that it has
    refused    key, permission, address or payment: no retry and no other request can help, so the run stops

What a server says decides, in words, codes and statuses (`tacevo.llm.words`), whatever status it says it with.

The providers' SDKs retry too, but neither asks again after a malformed body, none tells when it does, and one waits for
as many days as a server names. So theirs are switched off, and this is the one rule.
"""

import contextlib
import json
import math
import os
import re
import ssl
import time
from asyncio import CancelledError
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from enum import StrEnum
from typing import Any

import httpx2

from tacevo.llm.wire import by_certificates, by_proxy
from tacevo.llm.words import (
    PASSING,
    decisive_status,
    is_about_request,
    is_filtered,
    lacks_money,
    wants_no_system_prompt,
    words_of,
)
from tacevo.records import Json

#: The settings by which a provider draws tokens, and which a model may refuse; the last one named goes first.
SAMPLING = ("temperature", "top_p", "top_k", "seed")

_THINKING = r"\b(thinking|budget_tokens)\b"

#: The other settings that a server may refuse, by the names that servers have for them. A request without one of them
#: would be another one, so it is not sent again.
_NAMED = {
    "effort": r"\b(output_config|reasoning_effort|effort)\b",
    "thinking": _THINKING,
    "thinking_tokens": _THINKING,
    "max_tokens": r"\bmax_(completion_)?tokens\b",
    "stop_sequences": r"\bstop(_sequences)?\b",
}

#: The settings of a request that many models refuse: the first of such requests goes ahead of all others.
DOUBTED = frozenset({"effort", "thinking", "thinking_tokens"})

#: Characters of a server's words that a message has.
_LONGEST = 500

#: Raised before anything of a request is sent.
_UNSENT = (
    httpx2.ConnectError,
    httpx2.ConnectTimeout,
    httpx2.PoolTimeout,
    httpx2.ProxyError,
    httpx2.UnsupportedProtocol,
)


class FaultKind(StrEnum):
    """The kind of a fault, by what follows from it; see the module."""

    passing = "passing"
    request = "request"
    doubtful = "doubtful"
    unknown = "unknown"
    refused = "refused"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One failed try."""

    kind: FaultKind
    #: The fault as a person is told, in the server's words where it has any.
    message: str
    #: The HTTP status; 0 where there was none.
    status: int = 0
    #: Whether the request may have reached the server, and whether nothing came from there.
    sent: bool = True
    silent: bool = False
    #: Seconds that the server asks to wait; None where it does not say.
    retry_after: float | None = None
    #: The time when it happened, by `time.monotonic`.
    at: float = field(default_factory=time.monotonic, compare=False)

    @property
    def hopeless(self) -> bool:
        """Whether nothing further should begin: key or model is refused, or the server failed after all tries."""
        return self.kind in {FaultKind.refused, FaultKind.unknown, FaultKind.passing}

    @property
    def stop_reason(self) -> str:
        """The stop reason of a completion in place of an answer."""
        return "refusal" if is_filtered(self.message) else "invalid_request"

    @property
    def remedy(self) -> str:
        """The remedy: what the user can do about a refusal."""
        if self.status in {401, 403}:
            return "check the API key, and what it may be used for"
        if lacks_money(self.status, self.message):
            return "check the account: it has no money left, or is closed"
        if wants_no_system_prompt(self.message):
            return "set llm.system=user, which joins the system prompt to the first turn"
        return "check llm.base_url, llm.model, llm.max_tokens and the other settings of llm"


class FaultError(Exception):
    """Carries a fault out of a provider's SDK; it never leaves `tacevo.llm`."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.message)
        self.fault = fault


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """The number of tries of a request, and the waits between them; times in seconds."""

    tries: int = 10
    #: The number of tries where nothing ever came from the server.
    tries_unheard: int = 4
    first: float = 0.5
    #: The longest wait of our own choice.
    longest: float = 60.0
    #: The longest wait that a server may ask for; beyond it the request fails.
    longest_asked: float = 3600.0

    def wait(self, tried: int, fault: Fault, *, jitter: float, heard: bool = True) -> float | None:
        """Return how long to wait before the next try, in seconds; None to give up.

        The server's word counts where it gives one; else the wait doubles from try to try.

        Args:
            tried: tries so far, at least 1.
            fault: what the last one came to.
            jitter: in [0, 1); spreads the tries of many requests, and nothing else depends on it.
            heard: whether the server ever answered.
        """
        tries = self.tries if heard or not fault.silent else min(self.tries, self.tries_unheard)
        if tried >= tries or fault.kind is not FaultKind.passing:
            return None
        if fault.retry_after is not None:
            within = fault.retry_after <= self.longest_asked
            return fault.retry_after + self.first * jitter if within else None
        return min(self.first * 2.0 ** min(tried - 1, 60), self.longest) * (1 - jitter / 2)


def fault_of_status(status: int, headers: Mapping[str, str], body: Json, *, path: str | None = None) -> Fault:
    """Read a server's refusal; a code in its body decides as a status would (`tacevo.llm.words.decisive_status`).

    Args:
        status: the HTTP status; 200 for an error that stands where an answer should.
        headers: with names in lower case, or in a mapping that does not mind.
        body: the parsed JSON, or the text where it is none.
        path: what was asked for at the server, which need not say what it does not know; None where it knew the path.
    """
    decisive, words = decisive_status(status, body), words_of(body)
    kind = _kind(decisive, words)
    said = f"{'the body is not an answer' if decisive < 400 else decisive}: {words[:_LONGEST]}"
    if decisive == 404 and (path is None or re.search(r"\bmodel", words, re.IGNORECASE)):
        kind = FaultKind.unknown
    elif decisive == 404:
        said += f"; {path} was asked for: check llm.base_url, from which that path follows"
    return Fault(kind=kind, message=said, status=decisive, retry_after=_retry_after(headers))


def fault_of_body(body: Json) -> Fault:
    """Read a body of status 200 that holds no answer: an error that its server reports so, or what is no answer."""
    return fault_of_status(200, {}, body)


def fault_of(error: Exception) -> Fault:
    """Read what an SDK raised; the errors of all SDKs have the same fields."""
    if getattr(error, "status_code", 0) < 400:
        return fault_of_connection(error)
    refusal: Any = error
    body = refusal.body
    with contextlib.suppress(ValueError, RecursionError, httpx2.StreamError):  # an SDK may keep a part of it only
        body = json.JSONDecoder().raw_decode(refusal.response.text.strip().removeprefix("data:").lstrip())[0]
    return fault_of_status(refusal.status_code, refusal.response.headers, body, path=refusal.request.url.path)


def fault_of_connection(error: Exception) -> Fault:
    """Name a fault that came without a usable answer: a refused connection, a reset, a time-out, a malformed body."""
    causes = list(_causes(error))
    sent = not any(isinstance(cause, _UNSENT) for cause in causes)
    silent = any(isinstance(cause, httpx2.TransportError) for cause in causes)
    address = getattr(error, "request", None) and error.request.url  # type: ignore[attr-defined]
    said = f"{_because(causes)}{''.join(map(by_certificates, causes))}"
    if address is not None:
        where = f"{address.scheme}://{address.netloc.decode()}"
        said = f"{where}: {said}" if sent else f"no connection to {where}{by_proxy(address)}: {said}"
    return Fault(kind=FaultKind.passing, message=f"{type(error).__name__}: {said}", sent=sent, silent=silent)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and what is behind it, up to where a library waits for a socket."""
    while error is not None and not isinstance(error, CancelledError | ssl.SSLWantReadError):
        yield error
        error = error.__cause__ or error.__context__


def _because(causes: Sequence[BaseException]) -> str:
    """Say in a line what is behind an error: what the system says of a connection, else the innermost words."""
    if any(isinstance(cause, httpx2.TimeoutException) for cause in causes):
        return "no answer in time"
    last = next((cause for cause in reversed(causes) if str(cause)), causes[0])
    if isinstance(last, OSError) and not isinstance(last, ssl.SSLError) and (last.errno or 0) > 0:
        return os.strerror(last.errno or 0)
    return " ".join(str(last).split())[:500] or type(last).__name__


def setting_to_drop(fault: Fault, sent: Set[str]) -> str | None:
    """Find the sampling setting that a model refuses: of those sent and named in the refusal, the last.

    Some models refuse one setting, others two together; dropping one at a time loses no more than is needed.
    """
    if fault.kind is not FaultKind.doubtful:
        return None
    named = [name for name in SAMPLING if name in sent and re.search(rf"\b{name}\b", fault.message)]
    return named[-1] if named else None


def refused_setting(fault: Fault, sent: Set[str]) -> str | None:
    """Find the setting that a refusal is about and that is not dropped: of those sent, the one it names first."""
    if fault.kind not in {FaultKind.doubtful, FaultKind.request}:
        return None
    found = {name: re.search(pattern, fault.message) for name, pattern in _NAMED.items() if name in sent}
    places = {name: match.start() for name, match in found.items() if match is not None}
    return min(places, key=lambda name: places[name], default=None)


def _kind(status: int, said: str) -> FaultKind:
    if lacks_money(status, said):
        return FaultKind.refused
    if is_about_request(status, said):
        return FaultKind.request
    if status in PASSING or status < 400 or status >= 500:
        return FaultKind.passing
    return FaultKind.doubtful if status in {400, 422} else FaultKind.refused


def _retry_after(headers: Mapping[str, str]) -> float | None:
    """Read `retry-after`: seconds, or a date of HTTP; what makes no sense is as good as nothing."""
    value = headers.get("retry-after")
    if value is None:
        return None
    seconds = math.nan
    try:
        seconds = float(value)
    except ValueError:
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            seconds = parsedate_to_datetime(value).timestamp() - time.time()
    return max(seconds, 0.0) if math.isfinite(seconds) else None
