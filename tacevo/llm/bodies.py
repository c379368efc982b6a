"""The reading of a server's body, as far as it can be read; pure.

A text is paid for, so it is never thrown away because of what stands beside it: what is missing or nonsense there is
unknown. Without a text there is no answer, nor with one that the server marks as failed; the request is asked again.
"""

import json
from collections.abc import Mapping

from tacevo.llm.retry import Fault, FaultError, FaultKind, fault_of_body
from tacevo.llm.stops import stop_reason_of
from tacevo.llm.streams import DECODER, TEXTS, first_choice, joined, read_values
from tacevo.llm.words import error_in
from tacevo.records import Completion, Delivery, Json, token_count


def read_body(data: bytes) -> Json:
    """Read JSON in whatever encoding, and whatever media type it was sent as; an event stream is joined.

    Raises:
        FaultError: it is none, is nested too deeply, or is a stream that is not finished.
    """
    try:
        text = data.decode(json.detect_encoding(data), errors="replace")
        try:
            body: Json = DECODER.decode(text)
            return joined([body], is_done=False)
        except ValueError as error:
            alone = error
        try:
            return joined(*read_values(text))
        except ValueError:
            raise alone from None
    except RecursionError:
        said = "the body is nested too deeply"
    except ValueError as error:
        said = f"the body is not JSON: {error}"
    raise FaultError(Fault(kind=FaultKind.passing, message=said))


def read_message(body: Json, delivery: Delivery) -> Completion:
    """Read an answer of the Messages API; the model is as the server named it, for a name may stand for a dated one.

    Raises:
        FaultError: it holds no text, or says that it failed.
    """
    text = _text(body.get("content")) if isinstance(body, Mapping) else None
    if text is None or error_in(body) is not None:
        raise FaultError(fault_of_body(body))
    usage = _mapping(body, "usage")
    fresh, (read, written) = token_count(usage.get("input_tokens")), _cached(usage)
    whole = None if fresh is None or read is None or written is None else fresh + read + written
    # What is kept for an hour costs more; nothing here asks for that.
    hourly = _mapping(usage, "cache_creation").get("ephemeral_1h_input_tokens") not in (None, 0)
    return Completion(
        text=text,
        model=_word(body, "model"),
        stop_reason=stop_reason_of(_value(body, "stop_reason")),
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
        FaultError: it holds neither a text nor a reason why there is none, or says that it failed.
    """
    choices = body.get("choices") if isinstance(body, Mapping) else None
    choice = first_choice(choices) or (choices[0] if isinstance(choices, list) and choices else None)
    message, reason = _mapping(choice, "message"), _value(choice, "finish_reason")
    reason = reason[0] if isinstance(reason, list) and reason else reason
    reason = reason if isinstance(reason, str | Mapping) else None
    for part in (choice, message):
        if (error := error_in(part)) is not None:
            raise FaultError(fault_of_body({"error": error}))
    content = message.get("content")
    text = _text(content)
    refused = bool(message.get("refusal")) or (not text and _holds_refusal(content))
    lacks_text = text is None and (content is not None or not (message and (reason or refused)))
    if lacks_text or error_in(body) is not None:
        raise FaultError(fault_of_body(body))
    usage = _mapping(body, "usage")
    whole, (read, written) = token_count(usage.get("prompt_tokens")), _cached(usage)
    if not whole or (read or 0) + (written or 0) > whole:
        read, written = (None, None) if whole else (0, 0)
    return Completion(
        text=text or "",
        model=_word(body, "model"),
        stop_reason="refusal" if refused else stop_reason_of(reason),
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
        is_text = content.get("type", "text") in TEXTS
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


def _value(body: Json, name: str) -> Json:
    return body.get(name) if isinstance(body, Mapping) else None


def _word(body: Json, name: str) -> str:
    value = _value(body, name)
    return value if isinstance(value, str) else ""
