"""What may go wrong between a request and its answer, and what follows from it; the same for every provider.

    passing    rate limit, overload, time-out, server error, lost connection, unreadable body: asked again
    request    this request can never be answered (too long, filtered): recorded as an answer without text
    doubtful   refused, for this request or for every one: `tacevo.llm.failures` decides
    unknown    the server has no such model: the run stops, and names the models that it has
    refused    key, permission, address or payment: no retry and no other request can help, so the run stops

The providers' SDKs retry too, but not alike: neither asks again after a malformed body, and one gives up where the
server names a wait of more than two minutes. So theirs are switched off, and this is the one rule.
"""

import contextlib
import math
import os
import re
import ssl
import time
from asyncio import CancelledError
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from email.utils import parsedate_to_datetime
from enum import StrEnum
from typing import Any

import httpx2

from tacevo.llm.wire import by_proxy
from tacevo.records import Json

#: What a provider draws its tokens by, and a model may refuse; the last one named goes first.
SAMPLING = ("temperature", "top_p", "top_k", "seed")

#: Statuses below 500 that pass: time-out, conflict of locks, rate limit.
_PASSING = {408, 409, 429}

#: Statuses that may be about one request: bad request, too large, unprocessable.
_OF_A_REQUEST = {400, 413, 422}

#: How servers say that there is no money or no account, some with a status that would otherwise blame the request.
_PAYMENT = (
    "credit balance",
    "billing details",
    "billing_error",
    "insufficient_quota",
    "spend limit",
    "spending limit",
    "usage limit",
    "organization has been disabled",
)

#: The code of a spent quota; a rate limit, too, has status 429, and its words may mention limits and billing.
_QUOTA = ("insufficient_quota",)

#: How servers say that a request does not fit into a model; a limit of tokens per minute is another one.
_TOO_LONG = re.compile(
    r"too (long|large)|context (length|window|size)|maximum context"
    r"|(exceed|at most|(more|less|fewer|longer) than|maximum|limit|up to)[^.]{0,40}\b(tokens|characters)\b(?! per)"
    r"|\b(tokens|characters)\b(?! per)[^.]{0,40}(exceed|at most|(more|less|fewer) than|maximum|limit|> ?\d)",
    re.IGNORECASE,
)

#: What a limit on an answer's tokens is called, and how servers say that it is more than they take.
_LIMIT = re.compile(r"max_(completion_|new_|output_)?tokens|(output|completion) tokens", re.IGNORECASE)
_EXCESS = re.compile(r"too (large|high|big|many)|exceed|at most|less than|maximum|greater than|> ?\d", re.IGNORECASE)

#: How servers say that a model has no system prompt.
_NO_SYSTEM = re.compile(
    r"system\W{1,3}(role|message|prompt|instruction)s?\b.*\b(not|un\w+|only|must|cannot)\b|role\W{1,3}system\b"
    r"|support.{0,10}\bsystem\W{1,3}(role|message|prompt|instruction)|roles? must alternate|\bonly user\b"
    r"|developer instruction",
    re.IGNORECASE,
)

#: The statuses that errors without one would have, by their types or codes.
STATUSES = {
    "invalid_request_error": 400,
    "context_length_exceeded": 400,
    "authentication_error": 401,
    "invalid_api_key": 401,
    "billing_error": 402,
    "permission_error": 403,
    "not_found_error": 404,
    "model_not_found": 404,
    "request_too_large": 413,
    "insufficient_quota": 429,
    "rate_limit_error": 429,
    "rate_limit_exceeded": 429,
    "overloaded_error": 529,
}

#: How servers say that it is the model which they do not find.
_NO_MODEL = re.compile(r"\bmodel\b|model_not_found", re.IGNORECASE)

#: What stands for a server's words where it has none.
_UNSAID = "no explanation"

#: Raised before anything of a request is sent.
_UNSENT = (
    httpx2.ConnectError,
    httpx2.ConnectTimeout,
    httpx2.PoolTimeout,
    httpx2.ProxyError,
    httpx2.UnsupportedProtocol,
)

#: How servers say that they will not answer this.
_FILTERED = ("content filter", "content_filter", "content policy", "content management policy")


class FaultKind(StrEnum):
    """What follows from a fault; see the module."""

    passing = "passing"
    request = "request"
    doubtful = "doubtful"
    unknown = "unknown"
    refused = "refused"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One failed try."""

    kind: FaultKind
    #: For a person, in the server's words where it has any.
    message: str
    #: The HTTP status; 0 where there was none.
    status: int = 0
    #: Whether the request may have reached the server, and whether nothing came from there.
    sent: bool = True
    silent: bool = False
    #: Seconds that the server asks to wait; None where it does not say.
    retry_after: float | None = None
    #: When it happened, by `time.monotonic`.
    at: float = field(default_factory=time.monotonic, compare=False)

    @property
    def hopeless(self) -> bool:
        """Whether nothing further should begin: key or model is refused, or the server failed after all tries."""
        return self.kind in {FaultKind.refused, FaultKind.unknown, FaultKind.passing}

    @property
    def stop_reason(self) -> str:
        """The stop reason of a completion in place of an answer."""
        return "refusal" if _mentions(self.message, _FILTERED) else "invalid_request"

    @property
    def remedy(self) -> str:
        """What the user can do about a refusal."""
        if self.status in {401, 403}:
            return "check the API key, and what it may be used for"
        if self.status == 402 or _mentions(self.message, _PAYMENT):
            return "check the account: it has no money left, or is closed"
        if _NO_SYSTEM.search(self.message):
            return "set llm.system=user, which joins the system prompt to the first turn"
        return "check llm.base_url, llm.model and the other settings of llm"


class FaultError(Exception):
    """Carries a fault out of a provider's SDK; it never leaves `tacevo.llm`."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.message)
        self.fault = fault


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How often a request is tried, and how long between the tries; times in seconds."""

    tries: int = 10
    #: How often, where nothing ever came from the server.
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
    """Read a server's refusal.

    Args:
        status: the HTTP status, at least 400.
        headers: with names in lower case, or in a mapping that does not mind.
        body: the parsed JSON, or the text where it is none.
        path: what was asked for at the server, which need not say what it does not know; None where it knew the path.
    """
    said = f"{status}: {_said(body)}"
    kind = _kind(status, said)
    if status == 404 and (path is None or _NO_MODEL.search(said)):
        kind = FaultKind.unknown
    elif status == 404:
        said += f"; {path} was asked for: check llm.base_url, from which that path follows"
    return Fault(kind=kind, message=said, status=status, retry_after=_retry_after(headers))


def fault_of_body(body: Json) -> Fault:
    """Read a body of status 200 that holds no answer: an error that its server reports so, or what is no answer."""
    error, said = _error(body), _said(body)
    if not isinstance(body, dict) or not _words(error):
        held = ", ".join(body) if isinstance(body, dict) else _words(body)
        return Fault(kind=FaultKind.passing, message=f"the body is not an answer: {held[:80] or type(body).__name__}")
    marks = [str(error.get(name)) for name in ("code", "type")] if isinstance(error, dict) else []
    numbers = [STATUSES.get(mark, int(mark) if re.fullmatch("[0-9]{3}", mark) else 0) for mark in marks]
    status = next((number for number in numbers if 400 <= number < 600), 500)
    return replace(fault_of_status(status, {}, body), message=f"an error in a body of status 200: {said}")


def fault_of(error: Exception) -> Fault:
    """Read what an SDK raised; the errors of all SDKs have the same fields."""
    if getattr(error, "status_code", 0) < 400:
        return fault_of_connection(error)
    refusal: Any = error
    path = refusal.request.url.path
    return fault_of_status(refusal.status_code, refusal.response.headers, refusal.body, path=path)


def fault_of_connection(error: Exception) -> Fault:
    """Name a fault that came without a usable answer: a refused connection, a reset, a time-out, a malformed body."""
    causes = list(_causes(error))
    sent = not any(isinstance(cause, _UNSENT) for cause in causes)
    silent = any(isinstance(cause, httpx2.TransportError) for cause in causes)
    address = getattr(error, "request", None) and error.request.url  # type: ignore[attr-defined]
    said = _because(causes)
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


def _kind(status: int, said: str) -> FaultKind:
    if status == 402 or _mentions(said, _QUOTA if status == 429 else _PAYMENT):
        return FaultKind.refused
    large = _TOO_LONG.search(said) or (_LIMIT.search(said) and _EXCESS.search(said))
    if status == 413 or (status in _OF_A_REQUEST and (large or _mentions(said, _FILTERED))):
        return FaultKind.request
    if status not in _PASSING and _NO_SYSTEM.search(said):  # every request has a system prompt, or none
        return FaultKind.refused
    if status in _PASSING or status >= 500:
        return FaultKind.passing
    return FaultKind.doubtful if status in _OF_A_REQUEST else FaultKind.refused


def _mentions(said: str, phrases: tuple[str, ...]) -> bool:
    return any(phrase in said.lower() for phrase in phrases)


def _said(body: Json) -> str:
    """Find a server's own words: `{"error": {"message": ...}}`, FastAPI's `detail`, text; its code and type too."""
    error = _error(body)
    words = " ".join(_words(error).split())[:500] or _UNSAID
    if not isinstance(error, dict):
        return words
    marks = [error[name] for name in ("type", "code") if isinstance(error.get(name), str | int) and error[name]]
    return " ".join([words, *(f"({mark})" for mark in marks)])


def _error(body: Json) -> Json:
    """Return what a body holds as its error; the body itself where it has no such field."""
    return (body.get("error") or body) if isinstance(body, dict) else body


def _words(value: Json, depth: int = 5) -> str:
    """Find the words of an error, wherever they stand in it; where it concerns one of several settings, which."""
    if isinstance(value, str) or depth == 0:
        return value if isinstance(value, str) else ""
    if isinstance(value, Sequence):
        return "; ".join(filter(None, (_words(part, depth - 1) for part in value)))
    if not isinstance(value, Mapping):
        return ""
    found = (_words(value.get(name), depth - 1) for name in ("message", "msg", "detail", "error", "errors"))
    words, place = next(filter(None, found), ""), value.get("loc")
    return f"{'.'.join(map(str, place))}: {words}" if words and isinstance(place, list) else words


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
