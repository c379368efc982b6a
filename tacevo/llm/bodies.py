"""What a server's body says, as far as it can be read; pure.

A text is paid for, so it is never thrown away because of what stands beside it: what is missing or nonsense there is
unknown. Without a text there is no answer, and the request is asked again.
"""

import json
from collections.abc import Mapping

from tacevo.llm.retry import Fault, FaultError, FaultKind, fault_of_body
from tacevo.records import Completion, Delivery, Json, token_count

#: The kinds of parts that hold text; others hold thoughts, calls of tools, pictures.
_TEXTS = ("text", "output_text")

#: The reasons to stop, in the words of the Messages API, which the gate knows.
_STOP_REASONS = {"stop": "end_turn", "length": "max_tokens", "content_filter": "refusal"}

#: Digits of the longest number that is read as one.
_DIGITS = 20


def read_body(data: bytes) -> Json:
    """Read JSON in whatever encoding, and whatever media type it was sent as.

    Raises:
        FaultError: it is none, or nested too deeply.
    """
    try:
        text = data.decode(json.detect_encoding(data), errors="replace")
        body: Json = json.loads(text, parse_int=lambda digits: int(digits) if len(digits) <= _DIGITS else None)
        return body
    except RecursionError:
        said = "the body is nested too deeply"
    except ValueError as error:
        said = f"the body is not JSON: {error}"
    raise FaultError(Fault(kind=FaultKind.passing, message=said))


def read_message(body: Json, delivery: Delivery) -> Completion:
    """Read an answer of the Messages API; the model is as the server named it, for a name may stand for a dated one.

    Raises:
        FaultError: it holds no text.
    """
    text = _text(body.get("content")) if isinstance(body, Mapping) else None
    if text is None:
        raise FaultError(fault_of_body(body))
    usage = _mapping(body, "usage")
    fresh, (read, written) = token_count(usage.get("input_tokens")), _cached(usage)
    whole = None if fresh is None or read is None or written is None else fresh + read + written
    # What is kept for an hour costs more; nothing here asks for that.
    hourly = _mapping(usage, "cache_creation").get("ephemeral_1h_input_tokens") not in (None, 0)
    return Completion(
        text=text,
        model=_word(body, "model"),
        stop_reason=_word(body, "stop_reason") or "end_turn",
        input_tokens=whole,
        output_tokens=token_count(usage.get("output_tokens")),
        delivery=delivery,
        cache_read=read,
        cache_written=None if hourly else written,
    )


def read_chat(body: Json) -> Completion:
    """Read an answer of the chat-completions API.

    Its message may lack a text, because it is a refusal, or the limit was reached before it; the reason tells.

    Raises:
        FaultError: it holds neither a text nor a reason why there is none.
    """
    choices = body.get("choices") if isinstance(body, Mapping) else None
    choice = choices[0] if isinstance(choices, list) and choices else None
    message, reason = _mapping(choice, "message"), _word(choice, "finish_reason")
    content = message.get("content")
    text = _text(content)
    refused = bool(message.get("refusal")) or (not text and _holds_refusal(content))
    if text is None and (content is not None or not (message and (reason or refused))):
        raise FaultError(fault_of_body(choice if _mapping(choice, "error") else body))
    usage = _mapping(body, "usage")
    whole, (read, written) = token_count(usage.get("prompt_tokens")), _cached(usage)
    if not whole or (read or 0) + (written or 0) > whole:
        read, written = (None, None) if whole else (0, 0)
    return Completion(
        text=text or "",
        model=_word(body, "model"),
        stop_reason="refusal" if refused else _STOP_REASONS.get(reason, reason) or "end_turn",
        input_tokens=whole,
        output_tokens=token_count(usage.get("completion_tokens")),
        cache_read=read,
        cache_written=written,
    )


def _text(content: Json, depth: int = 5) -> str | None:
    """Join the texts of content: a text, a part, a list of both; None for what is none of these."""
    if isinstance(content, str) or depth == 0:
        return content if isinstance(content, str) else ""
    if isinstance(content, list):
        return "".join(_text(part, depth - 1) or "" for part in content)
    if isinstance(content, Mapping) and content:
        is_text = content.get("type", "text") in _TEXTS
        return _text(content.get("text", content.get("value")), depth - 1) if is_text else ""
    return None


def _holds_refusal(content: Json) -> bool:
    return isinstance(content, list) and any(_word(part, "type") == "refusal" for part in content)


def _cached(usage: Mapping[str, Json]) -> tuple[int | None, int | None]:
    """Return how many tokens were read from a cache, and written there; None for what is no number of tokens."""
    read = _mapping(usage, "prompt_tokens_details").get("cached_tokens")
    said = (usage.get("cache_read_input_tokens") if read is None else read, usage.get("cache_creation_input_tokens"))
    first, second = (0 if value is None else token_count(value) for value in said)
    return first, second


def _mapping(body: Json, name: str) -> Mapping[str, Json]:
    value = body.get(name) if isinstance(body, Mapping) else None
    return value if isinstance(value, Mapping) else {}


def _word(body: Json, name: str) -> str:
    value = body.get(name) if isinstance(body, Mapping) else None
    return value if isinstance(value, str) else ""
