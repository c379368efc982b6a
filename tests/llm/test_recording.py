"""Promise: every answer is stored the moment it arrives; what is recorded is not asked for; replay asks nobody."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from asked import request
from refusals import refused

from tacevo.errors import CacheMissError, LLMError, StoreError, TransportError
from tacevo.llm.recording import RecordingLLM
from tacevo.parts.provider import Keep
from tacevo.records import Completion, Mode, Price, Request, to_json
from tacevo.storage.store import Store


class FakeLLM:
    """Numbers its answers, gives the last request's first, and fails after so many."""

    def __init__(self, answers: int = 1000) -> None:
        self.asked: list[str] = []
        self._answers = answers

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer in reverse."""
        for position in reversed(range(len(requests))):
            if len(self.asked) == self._answers:
                raise TransportError("no network")
            self.asked.append(requests[position].messages[0].content)
            yield position, keep(requests[position], answer(f"{self.asked[-1]} answered as number {len(self.asked)}"))


def answer(text: str) -> Completion:
    """Make a completion."""
    return Completion(text=text, model="m-1", stop_reason="end_turn", input_tokens=2, output_tokens=3)


def texts(llm: RecordingLLM, requests: Sequence[Request]) -> list[str]:
    """Ask, and return the answers in the order of the requests."""
    answers = dict(llm.complete(requests))
    assert sorted(answers) == list(range(len(requests)))
    return [answers[position].text for position in range(len(requests))]


def completions(root: Path, mode: Mode = Mode.record) -> Store:
    """Open the store of completions."""
    return Store(root, "completions", mode)


REQUESTS = [request("a"), request("b"), request("c")]
ANSWERS = ["a answered as number 3", "b answered as number 2", "c answered as number 1"]


def test_record_asks_once(tmp_path: Path) -> None:
    """The first time the model is asked, the second time the store."""
    inner = FakeLLM()
    llm = RecordingLLM(inner, completions(tmp_path))
    assert texts(llm, REQUESTS) == ANSWERS
    assert texts(llm, REQUESTS) == ANSWERS
    assert inner.asked == ["c", "b", "a"]


def test_record_asks_only_for_what_is_missing(tmp_path: Path) -> None:
    """Recorded answers come first, each in its place, and the model sees the other requests alone."""
    completions(tmp_path).write(to_json(REQUESTS[1]), to_json(answer("recorded")))
    inner = FakeLLM()
    arrivals = list(RecordingLLM(inner, completions(tmp_path)).complete(REQUESTS))
    assert arrivals[0] == (1, answer("recorded"))
    assert sorted(position for position, _ in arrivals[1:]) == [0, 2]
    assert inner.asked == ["c", "a"]


def test_live_always_asks_and_records(tmp_path: Path) -> None:
    """A recorded answer is not read; the new one takes its place."""
    completions(tmp_path).write(to_json(REQUESTS[0]), to_json(answer("old")))
    inner = FakeLLM()
    new = texts(RecordingLLM(inner, completions(tmp_path, Mode.live)), REQUESTS[:1])
    assert inner.asked == ["a"]
    assert texts(RecordingLLM(None, completions(tmp_path, Mode.replay)), REQUESTS[:1]) == new


def test_replay_never_asks(tmp_path: Path) -> None:
    """A replay gives what was recorded, and a missing answer is an error although somebody could be asked."""
    texts(RecordingLLM(FakeLLM(), completions(tmp_path)), REQUESTS)
    inner = FakeLLM()
    llm = RecordingLLM(inner, completions(tmp_path, Mode.replay))
    assert texts(llm, REQUESTS) == ANSWERS
    with refused(CacheMissError, got="whose field 'draw' differs"):
        texts(llm, [request("a", draw=2)])
    assert inner.asked == []


def test_answer_is_stored_before_it_is_seen(tmp_path: Path) -> None:
    """Whoever sees an answer can be killed at once: it is recorded already."""
    replay = completions(tmp_path, Mode.replay)
    for position, completion in RecordingLLM(FakeLLM(), completions(tmp_path)).complete(REQUESTS):
        assert replay.find(to_json(REQUESTS[position])) == to_json(completion)


def test_failure_keeps_what_had_arrived(tmp_path: Path) -> None:
    """After a failure the next run asks only for what had not come."""
    with pytest.raises(TransportError, match="no network"):
        texts(RecordingLLM(FakeLLM(answers=2), completions(tmp_path)), REQUESTS)
    later = FakeLLM()
    assert texts(RecordingLLM(later, completions(tmp_path)), REQUESTS)[1:] == ANSWERS[1:]
    assert later.asked == ["a"]


@pytest.mark.parametrize("mode", [Mode.live, Mode.record])
def test_equal_requests_are_asked_once(mode: Mode, tmp_path: Path) -> None:
    """Equal requests get one answer, because a replay could not tell two apart; another draw is another request."""
    inner = FakeLLM()
    requests = [request("a"), request("b"), request("a"), request("a", draw=2)]
    first = texts(RecordingLLM(inner, completions(tmp_path, mode)), requests)
    assert first[0] == first[2] != first[3]
    assert sorted(inner.asked) == ["a", "a", "b"]
    assert texts(RecordingLLM(None, completions(tmp_path, Mode.replay)), requests) == first


def test_nobody_to_ask_is_an_error(tmp_path: Path) -> None:
    """Without a model a missing answer is an error in every mode."""
    with refused(LLMError, got="no model to ask"):
        texts(RecordingLLM(None, completions(tmp_path)), REQUESTS[:1])


def test_damaged_recording_is_never_asked_for_anew(tmp_path: Path) -> None:
    """Damage is an error, and costs no call."""
    store = completions(tmp_path)
    store.write(to_json(REQUESTS[0]), to_json(answer("recorded")))
    next(tmp_path.rglob("*.json")).write_text("{", encoding="utf-8")
    inner = FakeLLM()
    with refused(StoreError, expected="JSON"):
        texts(RecordingLLM(inner, store), REQUESTS)
    assert inner.asked == []


def test_price_is_stored_with_the_answer(tmp_path: Path) -> None:
    """What an answer cost is known to a replay, years later."""
    price = Price(input_usd=1.0, output_usd=5.0, dated="2026-11-21")
    llm = RecordingLLM(FakeLLM(), completions(tmp_path), price=lambda request, completion: price)
    assert {completion.price for _, completion in llm.complete(REQUESTS)} == {price}
    replayed = RecordingLLM(None, completions(tmp_path, Mode.replay)).complete(REQUESTS)
    assert {completion.price for _, completion in replayed} == {price}


def test_lone_surrogates_are_replaced_before_they_are_seen(tmp_path: Path) -> None:
    """Half an emoji, which no UTF-8 file can hold, neither stops a search nor differs in its replay."""

    class Halves:
        def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
            halves = Completion(text="\ud83d", model="m\ud83d", stop_reason="e\ud83d", input_tokens=1, output_tokens=1)
            yield 0, keep(requests[0], halves)

    ((_, completion),) = RecordingLLM(Halves(), completions(tmp_path)).complete(REQUESTS[:1])
    assert (completion.text, completion.model, completion.stop_reason) == ("?", "m?", "e?")
    assert texts(RecordingLLM(None, completions(tmp_path, Mode.replay)), REQUESTS[:1]) == ["?"]
