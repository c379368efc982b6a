"""An answer that comes in pieces: read from what a server or a proxy sends, and joined to the body of one answer; pure.

Requests ask for no stream (`"stream": false`), and some servers send one all the same. What is finished was paid for,
and is taken; what is not is no answer. So JSON may be followed by `data: [DONE]`, or come as the events of either API.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from tacevo.llm.retry import Fault, FaultError, FaultKind, fault_of_body
from tacevo.llm.wire import MOST_BYTES
from tacevo.llm.words import error_in
from tacevo.records import Json

#: Digits of the longest number that is read as one.
_DIGITS = 20

#: Reads JSON of servers; a longer number is None.
DECODER = json.JSONDecoder(parse_int=lambda digits: int(digits) if len(digits) <= _DIGITS else None)

#: The last event of a chat-completions stream.
_DONE = "[DONE]"

#: The beginning of a line of an event stream that holds no data: the other fields, and comments.
_OTHER = re.compile("(event|id|retry)?:")

#: The blanks between two values.
_BLANK = re.compile(r"\s*")

#: The kinds of parts of a message that hold text.
TEXTS = ("text", "output_text")


def read_values(text: str) -> tuple[list[Json], bool]:
    """Read JSON, alone, behind `data:` or several values one after the other, up to what is none.

    Returns:
        The values, and whether `[DONE]` stands behind them.

    Raises:
        ValueError: there is none.
        RecursionError: one is nested too deeply.
    """
    lines = (line for line in re.split("\\r\\n|\\n|\\r", text.lstrip("\ufeff")) if not _OTHER.match(line))
    left = "\n".join(line.removeprefix("data:") for line in lines).strip()
    values: list[Json] = []
    position = 0
    while position < len(left) and not left.startswith(_DONE, position):
        try:
            value, end = DECODER.raw_decode(left, position)
        except ValueError:
            if not values:
                raise
            break
        values.append(value)
        position = _BLANK.match(left, end).end()  # type: ignore[union-attr]
    if not values:
        raise ValueError("it is empty")
    return values, left.startswith(_DONE, position)


def joined(values: Sequence[Json], is_done: bool) -> Json:
    """Return the body of the one answer that values are, at least one; the first is that body if it is whole.

    Raises:
        FaultError: the pieces hold an error, or the answer is not finished.
    """
    if isinstance(values[0], list) and _holds_answer(values[0]):
        values = values[0]
    if not _is_piece(values[0]) and (len(values) == 1 or _is_finished(values[0])):
        return values[0]
    pieces = _Pieces(is_finished=is_done)
    for value in values:
        if isinstance(value, Mapping):
            pieces.add(value)
    return pieces.body()


@dataclass(slots=True, kw_only=True)
class _Pieces:
    """The pieces of an answer that a stream's events have brought so far, in either API."""

    is_finished: bool
    is_chat: bool = True
    texts: list[str] = field(default_factory=list)
    refusal: str = ""
    model: Json = None
    reason: Json = None
    usage: dict[str, Json] = field(default_factory=dict)

    def add(self, event: Mapping[str, Json]) -> None:
        """Take in the next event."""
        choice = first_choice(event.get("choices"))
        error = error_in(event) or error_in(choice)
        if error is not None:
            raise FaultError(fault_of_body({"error": error}))
        message = _mapping(event.get("message"))
        self.model = self.model or event.get("model") or message.get("model")
        for usage in (message.get("usage"), event.get("usage")):
            self.usage |= {name: value for name, value in _mapping(usage).items() if value is not None}
        self.is_chat = self.is_chat and not _is_event(event)
        if self.reason is None or not self.is_chat:
            self._add_text(event, choice)
        self.reason = self.reason or _ended(choice.get("finish_reason"))
        self.reason = self.reason or _ended(_mapping(event.get("delta")).get("stop_reason"))
        self.is_finished = self.is_finished or self.reason is not None or event.get("type") == "message_stop"

    def _add_text(self, event: Mapping[str, Json], choice: Mapping[str, Json]) -> None:
        for part in (event.get("content_block"), event.get("delta"), choice.get("delta")):
            delta = _mapping(part)
            text = delta.get("content", delta.get("text"))
            if delta.get("type", "text") in {*TEXTS, "text_delta"}:
                self.texts += _texts(text)
            self.refusal += "".join(_texts(delta.get("refusal")))
        # The last event may have the whole message once more, and so may all of them.
        whole = "".join(_texts(_mapping(choice.get("message")).get("content")))
        if whole:
            is_all = len(whole) >= sum(map(len, self.texts)) and whole.startswith("".join(self.texts))
            self.texts = [whole] if is_all else [*self.texts, whole]

    def body(self) -> Json:
        """Write the one answer."""
        if not self.is_finished:
            raise FaultError(Fault(kind=FaultKind.passing, message="the stream ended before its answer was finished"))
        text = "".join(self.texts)
        if len(text) > MOST_BYTES:
            message = f"the text of the stream is longer than {MOST_BYTES:,} characters"
            raise FaultError(Fault(kind=FaultKind.passing, message=message))
        usage: Json = self.usage or None
        if not self.is_chat:
            content: Json = [{"type": "text", "text": text}]
            return {"model": self.model, "content": content, "stop_reason": self.reason, "usage": usage}
        said: Json = {"content": text or None, "refusal": self.refusal}
        return {"model": self.model, "choices": [{"message": said, "finish_reason": self.reason}], "usage": usage}


def _holds_answer(values: Sequence[Json]) -> bool:
    """Answer whether a list is one of pieces, or has an answer in it and nothing else."""
    return any(map(_is_piece, values)) or (len(values) == 1 and isinstance(values[0], Mapping))


def _is_piece(value: Json) -> bool:
    """Answer whether a value is an event of a stream, and not an answer by itself."""
    return isinstance(value, Mapping) and (_is_event(value) or "delta" in first_choice(value.get("choices")))


def _is_event(value: Mapping[str, Json]) -> bool:
    """Answer whether a value is an event of the Messages API."""
    return str(value.get("type", "")).startswith(("message_", "content_block_"))


def _is_finished(value: Json) -> bool:
    """Answer whether a value says why its answer ended."""
    choice = first_choice(_mapping(value).get("choices"))
    return bool(_ended(choice.get("finish_reason")) or _ended(_mapping(value).get("stop_reason")))


def _ended(reason: Json) -> Json:
    """Return why an answer ended; None also for the words by which servers say that it has not."""
    is_going_on = isinstance(reason, str) and reason.casefold() in {"", "null", "none", "unfinished", "in_progress"}
    return None if is_going_on else reason


def first_choice(choices: Json) -> Mapping[str, Json]:
    """Return the first choice, which alone was asked for; empty for what has none."""
    several = choices if isinstance(choices, list) else []
    return next((one for one in map(_mapping, several) if one.get("index", 0) in {0, None}), {})


def _mapping(value: Json) -> Mapping[str, Json]:
    return value if isinstance(value, Mapping) else {}


def _texts(content: Json) -> Iterator[str]:
    """Yield the texts of a piece: a text, or a list of parts."""
    if isinstance(content, str):
        yield content
    elif isinstance(content, list):
        for part in content:
            if _mapping(part).get("type", "text") in TEXTS:
                yield from _texts(_mapping(part).get("text"))
