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
import re
import time
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from email.utils import parsedate_to_datetime
from enum import StrEnum
from typing import Any

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

#: How servers say that a request does not fit into a model.
_TOO_LONG = ("too long", "too large", "context length", "context window", "context size", "maximum context")

#: How servers say that it is the model which they do not find.
_NO_MODEL = re.compile(r"\bmodel\b|model_not_found", re.IGNORECASE)

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


class FaultError(Exception):
    """Carries a fault out of a provider's SDK; it never leaves `tacevo.llm`."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.message)
        self.fault = fault


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """How often a request is tried, and how long between the tries; times in seconds."""

    tries: int = 10
    first: float = 0.5
    #: The longest wait of our own choice.
    longest: float = 60.0
    #: The longest wait that a server may ask for; beyond it the request fails.
    longest_asked: float = 3600.0

    def wait(self, tried: int, fault: Fault, *, jitter: float) -> float | None:
        """Return how long to wait before the next try, in seconds; None to give up.

        The server's word counts where it gives one; else the wait doubles from try to try.

        Args:
            tried: tries so far, at least 1.
            fault: what the last one came to.
            jitter: in [0, 1); spreads the tries of many requests, and nothing else depends on it.
        """
        if tried >= self.tries or fault.kind is not FaultKind.passing:
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
    return Fault(kind=kind, message=said, retry_after=_retry_after(headers))


def fault_of(error: Exception) -> Fault:
    """Read what an SDK raised; the errors of all SDKs have the same fields."""
    if getattr(error, "status_code", 0) < 400:
        return fault_of_connection(error)
    refusal: Any = error
    path = refusal.request.url.path
    return fault_of_status(refusal.status_code, refusal.response.headers, refusal.body, path=path)


def fault_of_connection(error: Exception) -> Fault:
    """Name a fault that came without a usable answer: a refused connection, a reset, a time-out, a malformed body."""
    return Fault(kind=FaultKind.passing, message=f"{type(error).__name__}: {error}")


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
    if status in _PASSING or status >= 500:
        return FaultKind.passing
    if status not in _OF_A_REQUEST:
        return FaultKind.refused
    certain = status == 413 or _mentions(said, _TOO_LONG) or _mentions(said, _FILTERED)
    return FaultKind.request if certain else FaultKind.doubtful


def _mentions(said: str, phrases: tuple[str, ...]) -> bool:
    return any(phrase in said.lower() for phrase in phrases)


def _said(body: Json) -> str:
    """Find a server's own words: `{"error": {"message": ...}}`, or what the SDK left of it; its code and type too."""
    error = body.get("error", body) if isinstance(body, dict) else body
    if not isinstance(error, dict):
        return str(error or "no explanation")[:500]
    marks = [str(error[name]) for name in ("type", "code") if error.get(name)]
    return " ".join([str(error.get("message", "no explanation"))[:500], *(f"({mark})" for mark in marks)])


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
