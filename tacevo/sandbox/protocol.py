"""The messages between search, zygote, supervisor and candidate: lengths, JSON and raw bytes, never a pickle.

A message is 13 bytes (sort, header length, payload length, big-endian), then the header as JSON in UTF-8, then
the payload. Nothing is trusted: a reader checks every length against a limit before it stores a byte. It refuses a
header that a store could not write (NaN, infinity, lone surrogates) or that is nested deeply.
"""

import json
import re
import socket
import struct
import sys
import time
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Self

from tacevo.records import Json

#: A header as it was sent. Those of the search are read as they are, because a child has no Pydantic; those of a
#: candidate become records by `tacevo.sandbox.client.Frame.read`.
Header = Any
#: Levels of lists and objects in a header; the deepest honest one, a probe's answer, has six.
_DEEPEST = 50
_HEAD = struct.Struct("!BIQ")
_CHUNK = 2**18


class TooMuchError(ValueError):
    """A sender sent, or announced, more than it may."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Most that a sender may send in all."""

    total_bytes: int
    #: Parsed headers take up to forty times their length in the reader's memory.
    header_bytes: int
    messages: int


#: The bounds of one child's messages. The largest header of a network within the default limits of the gate (2,000
#: operations, 5,000 recorded steps) has 1.1 MB; a training sends a message of 45 bytes of header for each epoch.
CHILD = Bounds(total_bytes=64 * 2**20, header_bytes=2 * 2**20, messages=10_000)


class Sort(IntEnum):
    """The sort of a message."""

    #: Search to zygote, once: entries and imports. Zygote to search: that it is ready, or why not.
    setup = 1
    #: Search to zygote, once: the files of the arrays, which are not known when it starts.
    arrays = 11
    #: Search to supervisor: one job, with its limits.
    job = 2
    #: Supervisor to search: its process id.
    hello = 3
    #: Child to supervisor: it is confined and about to run the entry. Passed on to the search where a device was made
    #: ready first: the candidate's time begins.
    ready = 4
    #: Child to search, through the supervisor: part of the answer.
    frame = 5
    #: Child to supervisor, its last message: the entry returned, raised, or was refused memory.
    done = 6
    raised = 7
    starved = 8
    #: Child to supervisor, its last message: it needs a module that the zygote did not import.
    unprepared = 10
    #: Supervisor to search: how it ended (its last message).
    verdict = 9
    #: Search to supervisor, where frames are scored: whether this frame's score is the lowest so far.
    scored = 12


@dataclass(frozen=True, slots=True)
class Message:
    """A message whose header is not parsed yet, because a supervisor passes it on unread."""

    sort: Sort
    header: bytes
    payload: bytes

    def read_header(self) -> Header:
        """Parse the header.

        Raises:
            ValueError: it is not JSON that can be written as UTF-8, or it is nested too deeply.
        """
        too_deep = f"expected at most {_DEEPEST} levels in a header; got more"
        try:
            value = json.loads(self.header)
        except RecursionError as error:
            raise ValueError(too_deep) from error
        if _is_deeper(value, _DEEPEST):  # later code walks it by recursion
            raise ValueError(too_deep)
        json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
        return value

    def to_bytes(self) -> bytes:
        """Write the message in its wire form."""
        return _HEAD.pack(self.sort, len(self.header), len(self.payload)) + self.header + self.payload

    @classmethod
    def of(cls, sort: Sort, header: Json, payload: bytes = b"") -> Self:
        """Make a message from a header that is not yet written as JSON.

        Raises:
            ValueError: the header holds NaN or infinity.
        """
        return cls(sort, json.dumps(header, allow_nan=False).encode(), payload)


class Splitter:
    """Cuts a stream of bytes into messages; bounds say how much may come in all, None for a trusted sender."""

    def __init__(self, bounds: Bounds | None) -> None:
        self._bounds = bounds
        self._buffer = bytearray()
        self._bytes = self._header_bytes = self._messages = 0

    def feed(self, data: bytes) -> list[Message]:
        """Take the next bytes and return every message that they complete.

        Raises:
            TooMuchError: the sender sent, or announced, more than the bounds allow.
            ValueError: the bytes are not messages.
        """
        self._bytes += len(data)
        if self._bounds is not None and self._bytes > self._bounds.total_bytes:
            raise TooMuchError(f"expected at most {self._bounds.total_bytes} bytes; got more")
        self._buffer += data
        messages = []
        while message := self._cut():
            messages.append(message)
        return messages

    def _cut(self) -> Message | None:
        """Take one whole message off the front of the buffer; None where it is not complete."""
        if len(self._buffer) < _HEAD.size:
            return None
        number, header_length, payload_length = _HEAD.unpack_from(self._buffer)
        sort = Sort(number)
        middle, end = _HEAD.size + header_length, _HEAD.size + header_length + payload_length
        if self._bounds is not None:
            self._check_size(self._bounds, header_length, end)
        if len(self._buffer) < end:
            return None
        message = Message(sort, bytes(self._buffer[_HEAD.size : middle]), bytes(self._buffer[middle:end]))
        del self._buffer[:end]
        self._header_bytes += header_length
        self._messages += 1
        return message

    def _check_size(self, bounds: Bounds, header_length: int, length: int) -> None:
        """Compare the lengths of the first message in the buffer with the bounds, before it is all there."""
        if self._bytes - len(self._buffer) + length > bounds.total_bytes:
            raise TooMuchError(f"expected at most {bounds.total_bytes} bytes in all; got a message of {length} bytes")
        if self._header_bytes + header_length > bounds.header_bytes:
            raise TooMuchError(f"expected at most {bounds.header_bytes} bytes of headers; got more")
        if self._messages == bounds.messages:
            raise TooMuchError(f"expected at most {bounds.messages} messages; got more")


class Channel:
    """A stream socket between two trusted processes, read message by message."""

    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self._splitter = Splitter(bounds=None)
        self._waiting: list[Message] = []

    def send(self, message: Message) -> None:
        """Send one message.

        Raises:
            OSError: the other side is gone.
        """
        self.stream.sendall(message.to_bytes())

    def receive(self, deadline: float | None = None) -> Message:
        """Wait for the next message, until a time by `time.monotonic` even if bytes keep coming.

        Without a deadline, the socket's own limit holds, which is one of silence.

        Raises:
            EOFError: the other side is gone.
            TimeoutError: the time has passed.
            ValueError: what came is not a message.
        """
        while not self._waiting:
            if deadline is not None:
                left = deadline - time.monotonic()
                if left <= 0:
                    raise TimeoutError("the message did not come in time")
                self.stream.settimeout(left)
            data = self.stream.recv(_CHUNK)
            if not data:
                raise EOFError("the other side closed the channel")
            self._waiting = self._splitter.feed(data)
        return self._waiting.pop(0)


def _is_deeper(value: Json, levels: int) -> bool:
    """Return whether lists and objects are nested in more levels than these, without recursion."""
    level: list[Any] = [value]
    for _ in range(levels + 1):
        nested = [inner for inner in level if isinstance(inner, list | dict)]
        level = [inner for outer in nested for inner in (outer.values() if isinstance(outer, dict) else outer)]
    return bool(nested)


#: The longest detail of a rejection, in characters.
LONGEST = 300
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{4,}")  # but not the middle of a shape such as 30400x64

#: The directories in which this Python has its modules, the innermost directory first.
_MODULES = re.compile(
    "|".join(re.escape(f"{place}/") for place in sorted(sys.path, key=len, reverse=True) if re.match("/.", place))
)


def one_line(text: str) -> str:
    """Return the first line of a text that is not blank, printable, without addresses, of at most 300 characters.

    Memory addresses differ between runs, and a terminal would obey control characters. Directories of modules, which
    errors of an import name, differ between machines, and would be published.
    """
    lines = (line.strip() for line in text[: 100 * LONGEST].splitlines())
    first = next((line for line in lines if line), "")
    shown = _ADDRESS.sub("0x...", _MODULES.sub("", first))
    return "".join(c if c.isprintable() else "?" for c in shown)[:LONGEST]


def describe(error: BaseException) -> str:
    """Return an exception's type and the first line of its message, cut by `one_line`."""
    name = type(error).__name__
    try:
        message = one_line(str(error))
    except Exception:  # a candidate's exception class may fail even here
        message = "(its message cannot be read)"
    return one_line(f"{name}: {message}" if message else name)
