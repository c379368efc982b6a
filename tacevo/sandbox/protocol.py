"""The messages between search, zygote, supervisor and candidate: lengths, JSON and raw bytes, never a pickle.

A message is 13 bytes (sort, header length, payload length, big-endian), then the header as JSON in UTF-8, then
the payload. Nothing is trusted: a reader checks every length against a limit before it stores a byte, and a
header that no store could write back (NaN, infinity, lone surrogates) is refused.
"""

import json
import socket
import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

from tacevo.records import Json

#: Most bytes that one child may send in all.
OUTPUT_LIMIT = 64 * 2**20

_HEAD = struct.Struct("!BIQ")
_CHUNK = 2**18


class TooMuchError(ValueError):
    """A sender said or sent more bytes than it may."""


class Sort(IntEnum):
    """What a message is."""

    #: Search to zygote, once: paths, entries and arrays. Zygote to search: it is ready, or why it is not.
    setup = 1
    #: Search to supervisor: one job, with its limits.
    job = 2
    #: Supervisor to search: its process id.
    hello = 3
    #: Child to supervisor: it is confined and about to run the entry.
    ready = 4
    #: Child to search, through the supervisor: part of the answer.
    frame = 5
    #: Child to supervisor, its last message: the entry returned, raised, or was refused memory.
    done = 6
    raised = 7
    starved = 8
    #: Supervisor to search: how it ended (its last message).
    verdict = 9


@dataclass(frozen=True, slots=True)
class Message:
    """A message whose header is not parsed yet, because a supervisor passes it on unread."""

    sort: Sort
    header: bytes
    payload: bytes

    def read_header(self) -> Json:
        """Parse the header.

        Raises:
            ValueError: it is not JSON that could be written back as UTF-8.
        """
        try:
            value = json.loads(self.header)
            json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
        except RecursionError as error:
            raise ValueError("the header is nested too deeply") from error
        return value

    def to_bytes(self) -> bytes:
        """Write the message in its wire form."""
        return _HEAD.pack(self.sort, len(self.header), len(self.payload)) + self.header + self.payload

    @classmethod
    def of(cls, sort: Sort, header: Json, payload: bytes = b"") -> Self:
        """Make a message from a header that is still an object.

        Raises:
            ValueError: the header holds NaN or infinity.
        """
        return cls(sort, json.dumps(header, allow_nan=False).encode(), payload)


class Splitter:
    """Cuts a stream of bytes into messages.

    Args:
        limit: most bytes that may come in all; None for a trusted sender.
    """

    def __init__(self, limit: int | None) -> None:
        self._buffer = bytearray()
        self._left = limit

    def feed(self, data: bytes) -> list[Message]:
        """Take the next bytes and give every message that they complete.

        Raises:
            TooMuchError: the sender said or sent more than the limit.
            ValueError: the bytes are no messages.
        """
        if self._left is not None:
            self._left -= len(data)
            if self._left < 0:
                raise TooMuchError("it sent too much")
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
        if self._left is not None and end - len(self._buffer) > self._left:
            raise TooMuchError(f"it announced a message of {end} bytes, which is too much")
        if len(self._buffer) < end:
            return None
        message = Message(sort, bytes(self._buffer[_HEAD.size : middle]), bytes(self._buffer[middle:end]))
        del self._buffer[:end]
        return message


class Channel:
    """A stream socket between two trusted processes, read message by message."""

    def __init__(self, stream: socket.socket) -> None:
        self.stream = stream
        self._splitter = Splitter(limit=None)
        self._waiting: list[Message] = []

    def send(self, message: Message) -> None:
        """Send one message.

        Raises:
            OSError: the other side is gone.
        """
        self.stream.sendall(message.to_bytes())

    def receive(self) -> Message:
        """Wait for the next message.

        Raises:
            EOFError: the other side is gone.
            TimeoutError: the socket has a time limit and it has passed.
            ValueError: what came is no message.
        """
        while not self._waiting:
            data = self.stream.recv(_CHUNK)
            if not data:
                raise EOFError("the other side closed the channel")
            self._waiting = self._splitter.feed(data)
        return self._waiting.pop(0)
