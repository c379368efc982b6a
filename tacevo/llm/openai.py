"""Servers that speak the chat-completions API (vLLM, Ollama, llama.cpp, OpenAI) through the official SDK.

The draw number is sent as `seed`: a server that honours it answers equal draws alike and different ones apart. The
key comes from OPENAI_API_KEY; a server of one's own may want none.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import httpx2

from tacevo.environment import install
from tacevo.errors import ConfigError
from tacevo.llm.bodies import read_body, read_chat
from tacevo.llm.failures import check_key
from tacevo.llm.hosted import Body, HostedLLM, SDKServer, asking, clients_for
from tacevo.llm.retry import FaultError, FaultKind, fault_of
from tacevo.parts.making import Given
from tacevo.records import Completion, Json, Request

try:
    import openai
except ModuleNotFoundError as missing:
    raise ConfigError("nothing", place="llm=openai", expected="the openai SDK", remedy=install("openai")) from missing

#: Seconds for an answer, and for a connection to stand; a server of one's own may think for long.
TIMEOUT = httpx2.Timeout(1800.0, connect=15.0)

#: The errors that the SDK raises, or lets through, where there is no usable answer.
_FAILURES = (openai.OpenAIError, ValueError, RecursionError)

#: The names that servers give to the token limit.
_LIMITS = ("max_tokens", "max_completion_tokens")

#: Stands for the key where a server wants none: the SDK insists on one.
_NO_KEY = "no-key"


def from_settings(given: Given) -> HostedLLM:
    """Make what asks a server by the settings of `llm`; raises as `connect`."""
    return asking(replace(given, prices=None), partial(connect, dialect=Dialect()))


@dataclass(slots=True)
class Dialect:
    """The spelling of a server, as a run learns it; no answer depends on that, so it is recorded nowhere."""

    #: The server's name for the token limit; None until it refused one name and took the other.
    limit: str | None = None


class OpenAIServer(SDKServer):
    """The chat-completions API (see `tacevo.llm.hosted.Server`).

    Args:
        limit: what the server is thought to call the token limit.
        dialect: what it is known to call it.
    """

    sampling: tuple[str, ...] = ("temperature", "seed")

    def __init__(self, clients: Sequence[openai.AsyncOpenAI], *, limit: str, dialect: Dialect) -> None:
        key = clients[0].api_key
        super().__init__(clients, () if key == _NO_KEY else (key,), _FAILURES)
        self._limit = limit
        self._dialect = dialect

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Try a request once (see `tacevo.llm.hosted.Server`), or with each name of the token limit once."""
        name = self._dialect.limit or self._limit
        try:
            return await self._ask(request, dropped, name)
        except FaultError as error:
            refused = re.search(rf"\b{name}\b", error.fault.message) and error.fault.kind is FaultKind.doubtful
            if not refused or name != self._limit:
                raise
            other = next(other for other in _LIMITS if other != name)
            try:
                completion = await self._ask(request, dropped, other)
            except FaultError as second:  # where it knows neither, the first name is the one that its words are about
                raise (error if second.fault.kind is FaultKind.doubtful else second) from None
        self._dialect.limit = other
        return completion

    async def _ask(self, request: Request, dropped: tuple[str, ...], limit: str) -> Completion:
        body = body_of(request, dropped, limit_name=limit)
        try:
            chat = await next(self.turns).chat.completions.with_raw_response.create(
                model=body.pop("model"), messages=body.pop("messages"), stream=False, extra_body=body
            )
        except _FAILURES as error:
            raise FaultError(fault_of(error)) from error
        return read_chat(read_body(chat.http_response.content))


def connect(base_url: str | None, concurrency: int, dialect: Dialect | None = None) -> OpenAIServer:
    """Prepare to ask the server at `base_url`, by default OpenAI's own; a missing key is an error at once.

    `dialect` is what the run knows of the server; it learns more.

    Raises:
        ConfigError: OpenAI's own server is meant, and the environment holds no key.
    """
    own = base_url is None and not os.environ.get("OPENAI_BASE_URL")
    key = os.environ.get("OPENAI_API_KEY") or (None if own else _NO_KEY)
    if key is None:
        expected = "an API key for OpenAI's own server"
        remedy = (
            "set it, name a server of yours by llm.base_url, replay with llm.mode=replay, or see the cost without one: "
            "--estimate"
        )
        raise ConfigError("nothing", place="OPENAI_API_KEY", expected=expected, remedy=remedy)
    check_key(key, "OPENAI_API_KEY")
    try:
        made = partial(openai.AsyncOpenAI, api_key=key, base_url=base_url)
        clients = clients_for(concurrency, TIMEOUT, made, openai.DefaultAsyncHttpxClient)
    except (openai.OpenAIError, httpx2.InvalidURL) as error:
        raise ConfigError(str(error), place="llm=openai", remedy="check llm.base_url") from error
    # OpenAI's newer models know only the one name, other servers may know only the other.
    limit = "max_completion_tokens" if own else "max_tokens"
    return OpenAIServer(clients, limit=limit, dialect=dialect or Dialect())


def body_of(request: Request, dropped: tuple[str, ...], *, limit_name: str) -> Body:
    """Write a request as the chat-completions API wants it."""
    system = [{"role": "system", "content": request.system}] if request.system else []
    settings: dict[str, Json] = {"seed": request.draw, **dict(request.settings)}
    if request.temperature is not None:
        settings["temperature"] = request.temperature
    stop = settings.pop("stop_sequences", None)
    if stop is not None:
        settings["stop"] = stop
    effort = settings.pop("effort", None)
    if effort is not None:
        settings["reasoning_effort"] = effort
    return {
        "model": request.model,
        "messages": [*system, *({"role": turn.role, "content": turn.content} for turn in request.messages)],
        limit_name: request.max_tokens,
        **{name: value for name, value in settings.items() if name not in dropped},
    }
