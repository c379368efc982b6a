"""Promise: messages survive any cutting of the stream, and no sender can make a reader hold more than its limit."""

import socket
import struct
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.sandbox.protocol import Bounds, Channel, Message, Sort, Splitter

MESSAGES = st.lists(
    st.builds(Message, st.sampled_from(Sort), st.binary(max_size=20), st.binary(max_size=40)), max_size=5
)


BOUNDS = Bounds(total_bytes=3_000, header_bytes=20, messages=5)


def frame(header: int, payload: int) -> bytes:
    """Write a frame of so many bytes."""
    return Message(Sort.frame, bytes(header), bytes(payload)).to_bytes()


@given(messages=MESSAGES, size=st.integers(1, 50))
def test_stream_can_be_cut_anywhere(messages: list[Message], size: int) -> None:
    """The pieces in which bytes arrive do not matter."""
    stream = b"".join(message.to_bytes() for message in messages)
    splitter = Splitter(Bounds(total_bytes=len(stream), header_bytes=100, messages=5))
    pieces = (stream[i : i + size] for i in range(0, len(stream), size))
    assert [message for piece in pieces for message in splitter.feed(piece)] == messages


@pytest.mark.parametrize(
    ("before", "data", "got"),
    [
        pytest.param(b"", frame(0, 3_000)[:20], "at most 3000 bytes in all; got a message of 3013", id="announced"),
        pytest.param(frame(1, 1_400) * 2, bytes(200), "at most 3000 bytes; got more", id="many small ones"),
        pytest.param(frame(15, 9) + frame(5, 9), frame(1, 0)[:13], "at most 20 bytes of headers", id="headers"),
        pytest.param(frame(0, 0) * 5, frame(0, 0), "at most 5 messages", id="messages"),
        pytest.param(b"", bytes([99]) + bytes(12), "is not a valid Sort", id="no sort of the protocol"),
    ],
)
def test_what_is_over_a_limit_is_refused_at_once(before: bytes, data: bytes, got: str) -> None:
    """All messages count together, and the one that is too much is refused by the length that it announces."""
    splitter = Splitter(BOUNDS)
    splitter.feed(before)
    with pytest.raises(ValueError, match=got):
        splitter.feed(data)


@pytest.mark.parametrize("nested", [b"[" * 50 + b"]" * 50, b'{"a":' * 50 + b"1" + b"}" * 50])
def test_deep_header_is_refused(nested: bytes) -> None:
    """Fifty levels are read and one more is not, long before a walk by recursion would fail."""
    assert Message(Sort.frame, nested, b"").read_header()
    with pytest.raises(ValueError, match="expected at most 50 levels in a header"):
        Message(Sort.frame, b"[" + nested + b"]", b"").read_header()


def test_sender_that_never_pauses_is_given_up_at_the_deadline() -> None:
    """A trickle of bytes does not prolong the wait: the deadline is that of the whole message."""
    ours, theirs = socket.socketpair()
    over = threading.Event()

    def trickle() -> None:
        theirs.sendall(struct.pack("!BIQ", Sort.frame, 0, 10**9))
        while not over.wait(0.01):
            theirs.sendall(b"x")

    with ours, theirs:
        sender = threading.Thread(target=trickle)
        sender.start()
        try:
            with pytest.raises(TimeoutError, match=r"timed out|in time"):
                Channel(ours).receive(time.monotonic() + 0.3)
        finally:
            over.set()
            sender.join()


def test_header_with_nan_cannot_be_made() -> None:
    """What could not be stored is not sent."""
    with pytest.raises(ValueError, match="not JSON compliant"):
        Message.of(Sort.frame, float("nan"))


def test_closed_channel_is_told() -> None:
    """A reader learns that the other side is gone, after it got what was sent before."""
    ours, theirs = socket.socketpair()
    with ours:
        with theirs:
            Channel(theirs).send(Message.of(Sort.hello, 1))
        channel = Channel(ours)
        assert channel.receive().read_header() == 1
        with pytest.raises(EOFError, match="closed the channel"):
            channel.receive()
