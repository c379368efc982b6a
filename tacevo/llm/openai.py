"""Servers that speak the chat-completions API (vLLM, Ollama, llama.cpp, OpenAI) through the official SDK.

The draw number is sent as `seed`: a server that honours it answers equal draws alike and different ones apart. The
key comes from OPENAI_API_KEY; a server of one's own may want none.
"""

import json
import os
from collections.abc import Sequence
from functools import partial

import httpx2

from tacevo.errors import ConfigError
from tacevo.llm.failures import check_key, checked
from tacevo.llm.hosted import Body, SDKServer, clients_for
from tacevo.llm.retry import Fault, FaultError, FaultKind, fault_of, fault_of_connection
from tacevo.records import Completion, Json, Request

try:
    import openai
    from openai.types.chat import ChatCompletion
except ModuleNotFoundError as missing:
    raise ConfigError(
        "nothing",
        place="llm=openai",
        expected="the openai SDK",
        remedy="install it with: pip install 'tacevo[openai]'",
    ) from missing

#: Seconds for an answer, and for a connection to stand; a server of one's own may think for long.
TIMEOUT = httpx2.Timeout(1800.0, connect=15.0)

#: What the SDK raises, or lets through, where there is no usable answer.
_FAILURES = (openai.OpenAIError, json.JSONDecodeError, UnicodeDecodeError)

#: The reasons to stop, in the words of the Messages API, which the gate knows.
_STOP_REASONS = {"stop": "end_turn", "length": "max_tokens", "content_filter": "refusal"}

#: Stands for the key where a server wants none: the SDK insists on one.
_NO_KEY = "no-key"


class OpenAIServer(SDKServer[openai.AsyncOpenAI]):
    """The chat-completions API (see `tacevo.llm.hosted.Server`).

    Args:
        limit_name: what the server calls the token limit.
    """

    sampling: tuple[str, ...] = ("temperature", "seed")

    def __init__(self, clients: Sequence[openai.AsyncOpenAI], *, limit_name: str) -> None:
        key = clients[0].api_key
        super().__init__(clients, () if key == _NO_KEY else (key,), _FAILURES)
        self._limit_name = limit_name

    async def ask(self, request: Request, dropped: tuple[str, ...]) -> Completion:
        """Try a request once (see `tacevo.llm.hosted.Server`)."""
        body = body_of(request, dropped, limit_name=self._limit_name)
        try:
            chat = await next(self.turns).chat.completions.create(
                model=body.pop("model"), messages=body.pop("messages"), extra_body=body
            )
        except _FAILURES as error:
            raise FaultError(fault_of(error)) from error
        return completion_of(chat)


def connect(base_url: str | None, concurrency: int) -> OpenAIServer:
    """Prepare to ask the server at `base_url`, by default OpenAI's own; a missing key is an error at once.

    Raises:
        ConfigError: OpenAI's own server is meant, and the environment holds no key.
    """
    own = base_url is None and not os.environ.get("OPENAI_BASE_URL")
    key = os.environ.get("OPENAI_API_KEY") or (None if own else _NO_KEY)
    if key is None:
        raise ConfigError(
            "nothing",
            place="OPENAI_API_KEY",
            expected="an API key for OpenAI's own server",
            remedy="set it, name a server of yours by llm.base_url, or replay with llm.mode=replay",
        )
    check_key(key, "OPENAI_API_KEY")
    try:
        made = partial(openai.AsyncOpenAI, api_key=key, base_url=base_url)
        clients = clients_for(concurrency, TIMEOUT, made, openai.DefaultAsyncHttpxClient)
    except (openai.OpenAIError, httpx2.InvalidURL) as error:
        raise ConfigError(str(error), place="llm=openai", remedy="check llm.base_url") from error
    # OpenAI's newer models know only the one name, other servers may know only the other.
    return OpenAIServer(clients, limit_name="max_completion_tokens" if own else "max_tokens")


def body_of(request: Request, dropped: tuple[str, ...], *, limit_name: str) -> Body:
    """Write a request as the chat-completions API wants it."""
    system = [{"role": "system", "content": request.system}] if request.system else []
    settings: dict[str, Json] = {"temperature": request.temperature, "seed": request.draw, **dict(request.settings)}
    stop = settings.pop("stop_sequences", None)
    if stop is not None:
        settings["stop"] = stop
    return {
        "model": request.model,
        "messages": [*system, *({"role": turn.role, "content": turn.content} for turn in request.messages)],
        limit_name: request.max_tokens,
        **{name: value for name, value in settings.items() if name not in dropped},
    }


def completion_of(chat: ChatCompletion) -> Completion:
    """Read an answer; a server that counts no tokens has used none.

    Raises:
        FaultError: the body is JSON, but not a completion.
    """
    choices = getattr(chat, "choices", None)  # the SDK checks no body: another one comes as text, or with any values
    if not isinstance(choices, list) or not choices:
        raise FaultError(Fault(kind=FaultKind.passing, message="the body is not a completion: it has no choices"))
    try:
        choice, usage = choices[0], chat.usage
        reason = "refusal" if getattr(choice.message, "refusal", None) else str(choice.finish_reason or "stop")
        completion = Completion(
            text=choice.message.content or "",
            model=chat.model,
            stop_reason=_STOP_REASONS.get(reason, reason),
            input_tokens=0 if usage is None else usage.prompt_tokens,
            output_tokens=0 if usage is None else usage.completion_tokens,
        )
    except AttributeError as error:
        raise FaultError(fault_of_connection(error)) from error
    return checked(completion)
