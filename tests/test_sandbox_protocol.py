"""Promise: messages survive any cutting of the stream, and no sender can make a reader hold more than its limit."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacevo.sandbox.protocol import Channel, Message, Sort, Splitter

MESSAGES = st.lists(
    st.builds(Message, st.sampled_from(Sort), st.binary(max_size=20), st.binary(max_size=40)), max_size=5
)


@given(messages=MESSAGES, size=st.integers(1, 50))
def test_stream_can_be_cut_anywhere(messages: list[Message], size: int) -> None:
    """The pieces in which bytes arrive do not matter."""
    stream = b"".join(message.to_bytes() for message in messages)
    splitter = Splitter(limit=len(stream))
    pieces = (stream[i : i + size] for i in range(0, len(stream), size))
    assert [message for piece in pieces for message in splitter.feed(piece)] == messages


def test_announced_length_over_the_limit_is_refused_at_once() -> None:
    """A reader does not wait for bytes that it would not keep."""
    with pytest.raises(ValueError, match="announced a message of 1013 bytes"):
        Splitter(limit=500).feed(Message(Sort.frame, b"", bytes(1000)).to_bytes()[:20])


def test_bytes_over_the_limit_are_refused() -> None:
    """Many small messages count together."""
    splitter = Splitter(limit=30)
    splitter.feed(Message(Sort.frame, b"1", b"").to_bytes() * 2)
    with pytest.raises(ValueError, match="it sent too much"):
        splitter.feed(Message(Sort.frame, b"1", b"").to_bytes())


def test_unknown_sort_is_refused() -> None:
    """A message is of a sort that the protocol has."""
    with pytest.raises(ValueError, match="is not a valid Sort"):
        Splitter(limit=None).feed(bytes([99]) + bytes(12))


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
