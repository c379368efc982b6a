"""Claude through the official SDK and the Messages API; the key comes from the environment only."""

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial

import anthropic
import httpx2
from anthropic.resources.messages import DEPRECATED_MODELS

from tacevo.errors import ConfigError
from tacevo.llm.bodies import read_body, read_message
from tacevo.llm.capabilities import BUDGETED
from tacevo.llm.failures import check_key
from tacevo.llm.hosted import Body, SDKServer, clients_for
from tacevo.llm.retry import FaultError, fault_of
from tacevo.llm.wire import bound, bound_results, certificates, check_proxies
from tacevo.records import Completion, Delivery, Json, Request

#: Seconds for an answer, and for a connection to stand.
TIMEOUT = httpx2.Timeout(600.0, connect=15.0)

#: Seconds for what the Models API says: a run goes on without.
_ASKING = httpx2.Timeout(15.0)

#: The errors that the SDK raises, or lets through, where there is no usable answer.
FAILURES = (anthropic.AnthropicError, ValueError, RecursionError)


class AnthropicServer(SDKServer):
    """The Messages API (see `tacevo.llm.hosted.Server`)."""

    sampling: tuple[str, ...] = ("temperature",)

    def __init__(self, clients: Sequence[anthropic.AsyncAnthropic]) -> None:
        super().__init__(clients, secrets_of(clients[0]), FAILURES)

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Try a request once (see `tacevo.llm.hosted.Server`)."""
        body = {**body_of(request, dropped), "stream": False}
        try:
            # `messages.create` warns of models that end, for each request anew; `tacevo.runs.providers` does so once.
            message = await next(self.turns).post("/v1/messages", body=body, cast_to=httpx2.Response)
        except FAILURES as error:
            raise FaultError(fault_of(error)) from error
        return read_message(read_body(message.content), Delivery.direct)


def connect(base_url: str | None, concurrency: int) -> AnthropicServer:
    """Prepare to ask Claude, or another server at `base_url`; a missing key is an error at once.

    Raises:
        ConfigError: the environment holds no key, or the address is not a URL.
    """
    with _explaining():
        made = partial(anthropic.AsyncAnthropic, base_url=base_url)
        clients = clients_for(concurrency, TIMEOUT, made, anthropic.DefaultAsyncHttpxClient)
        _check_key(clients[0])
        return AnthropicServer(clients)


def connect_batches(base_url: str | None) -> anthropic.Anthropic:
    """Prepare to submit batches to Claude; otherwise like `connect`."""
    return _connect_waiting(base_url, TIMEOUT, bound_results)


def _connect_waiting(
    base_url: str | None, timeout: httpx2.Timeout, limit: Callable[[httpx2.Response], None]
) -> anthropic.Anthropic:
    """Make a client that waits for each answer, whose bodies have a limit."""
    with _explaining():
        check_proxies(context := certificates(), anthropic.DefaultHttpxClient)
        http = anthropic.DefaultHttpxClient(timeout=timeout, verify=context, event_hooks={"response": [limit]})
        client = anthropic.Anthropic(base_url=base_url, max_retries=0, timeout=timeout, http_client=http)
        _check_key(client)
        return client


@dataclass(frozen=True, slots=True)
class ClaudeCatalogue:
    """What the Models API and the SDK tell of models (see `tacevo.llm.capabilities.Catalogue`)."""

    base_url: str | None

    def ask(self, model: str) -> Json:
        """Ask the Models API once; None where there is none, or its answer cannot be read."""
        try:
            with _connect_waiting(self.base_url, _ASKING, bound) as client:
                told = client.models.with_raw_response.retrieve(model)
                return read_body(told.http_response.content)
        except (*FAILURES, FaultError, httpx2.RequestError, httpx2.StreamError):
            return None

    def end(self, model: str) -> str | None:
        """Return the end of a model as the SDK has it, which it writes as `November 30th, 2026`."""
        written = re.sub(r"(\d)(st|nd|rd|th)\b", r"\1", DEPRECATED_MODELS.get(model, ""))
        try:
            return datetime.strptime(written, "%B %d, %Y").date().isoformat()
        except ValueError:
            return None


@contextlib.contextmanager
def _explaining() -> Iterator[None]:
    try:
        yield
    except (anthropic.AnthropicError, httpx2.InvalidURL) as error:
        raise ConfigError(
            str(error), place="llm=anthropic", remedy="check llm.base_url and ANTHROPIC_API_KEY"
        ) from error


def _check_key(client: anthropic.Anthropic | anthropic.AsyncAnthropic) -> None:
    """Reject a client without a usable key; the SDK itself would only notice when it asks.

    The SDK's other logins are not used: their tokens change while it asks, so they could not be blacked out.
    """
    if not secrets_of(client):
        remedy = "set it, replay with llm.mode=replay, or see the cost without one: --estimate"
        raise ConfigError("nothing", place="ANTHROPIC_API_KEY", expected="an API key", remedy=remedy)
    for key, variable in ((client.api_key, "ANTHROPIC_API_KEY"), (client.auth_token, "ANTHROPIC_AUTH_TOKEN")):
        check_key(key or "", variable)


def secrets_of(client: anthropic.Anthropic | anthropic.AsyncAnthropic) -> tuple[str, ...]:
    """Return what a client logs in with."""
    return tuple(key for key in (client.api_key, client.auth_token) if key)


def body_of(request: Request, dropped: tuple[str, ...]) -> Body:
    """Write a request as the Messages API wants it; the draw number stays here: it is not a setting of a model."""
    settings: dict[str, Json] = dict(request.settings)
    if request.temperature is not None:
        settings["temperature"] = request.temperature
    thinking = settings.pop("thinking_tokens", settings.get("thinking"))
    if isinstance(thinking, str):
        settings["thinking"] = {"type": thinking}
    elif thinking is not None:
        settings["thinking"] = {"type": BUDGETED, "budget_tokens": thinking}
    if "effort" in settings:
        settings["output_config"] = {"effort": settings.pop("effort")}
    return {
        "model": request.model,
        **({"system": request.system} if request.system else {}),
        "messages": [{"role": turn.role, "content": turn.content} for turn in request.messages],
        "max_tokens": request.max_tokens,
        **{name: value for name, value in settings.items() if name not in dropped},
    }
