"""Promise: work finishes in any order and outcomes come in slot order; equal sources are trained once."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import fakes
import pytest

from tacevo.errors import LLMError, SandboxError, TransportError
from tacevo.evolution.development import LLM, Effects, Outcome, develop
from tacevo.evolution.proposals import Proposal
from tacevo.profile import Admitted, Graph, Profile
from tacevo.records import ChatMessage, Completion, Operator, Reason, Rejection, Request, Stage, Training

PROFILE = Profile(parameters=1, flops=1, modules=1, graph=Graph(nodes=(), edges=(), channels=(), kernels=(), hidden=()))
REFUSAL = Rejection(stage=Stage.extract, reason=Reason.no_class, detail="there was no class")
CRASH = Rejection(stage=Stage.train, reason=Reason.crashed, detail="signal 11")

Evaluate = Callable[[str], Training | Rejection]


class FakeLLM:
    """Answers the last request first: by its text, or, where an answer was sent back, by what comes after that one.

    It stops with an error after so many answers, and counts each round.
    """

    def __init__(self, corrections: Mapping[str, str] = MappingProxyType({}), *, answers: int = 1000) -> None:
        self._corrections, self._answers = corrections, answers
        self.rounds: list[int] = []

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer in reverse."""
        self.rounds.append(len(requests))
        for number, position in enumerate(reversed(range(len(requests)))):
            if number == self._answers:
                raise TransportError("no network")
            turns = [turn.content for turn in requests[position].messages]
            text = turns[0] if len(turns) == 1 else self._corrections.get(turns[-2], turns[-2])
            yield position, Completion(text=text, model="m", stop_reason="end_turn", input_tokens=1, output_tokens=1)


def proposals(*texts: str) -> list[Proposal]:
    """Make the baseline, and one mutation a text."""
    changes: dict[str, Any] = {"parents": (), "prompt": None, "request": None, "source": "baseline"}
    baseline = replace(mutation(0, ""), operator=Operator.baseline, **changes)
    return [baseline, *(mutation(slot, text) for slot, text in enumerate(texts, 1))]


def mutation(slot: int, text: str) -> Proposal:
    """Make a proposal whose answer is a given text."""
    messages = (ChatMessage(role="user", content=text),)
    request = Request(model="m", system="", messages=messages, temperature=0.5, max_tokens=1, draw=slot)
    return Proposal(generation=0, slot=slot, operator=Operator.mutation, parents=("g00s00",), prompt=0, request=request)


def trained(source: str) -> Training:
    """Return a training whose weights tell the source."""
    return Training(train_losses=(1.0,), validation_losses=(0.5,), predictions_sha256="", weights_sha256=source)


def judged(source: str) -> Admitted | Rejection:
    """Admit all but what begins with `bad`."""
    return REFUSAL if source.startswith("bad") else Admitted(source=source, profile=PROFILE)


def run(
    planned: list[Proposal],
    evaluate: Evaluate = trained,
    *,
    llm: LLM | None = None,
    inspect: Callable[[str], Admitted | Rejection] = judged,
    workers: int = 4,
    repairs: int = 0,
) -> list[Outcome]:
    """Develop proposals."""
    with ThreadPoolExecutor(workers) as executor:
        effects = Effects(
            llm=llm or FakeLLM(),
            admit=lambda completion, asked: inspect(completion.text),
            inspect=inspect,
            measure=inspect,
            evaluate=evaluate,
            evaluation_key=str,
            executor=executor,
            cpu_seconds=lambda: 0.0,
        )
        return list(develop(planned, effects, repairs=repairs))


def weights(outcomes: list[Outcome]) -> list[str]:
    """Tell which source each outcome was trained from."""
    return [outcome.result.weights_sha256 for outcome in outcomes if isinstance(outcome.result, Training)]


def test_slot_order_holds_whatever_finishes_first() -> None:
    """Each training here waits for that of the slot after it, so that they finish in exactly the reverse order."""
    order = ["baseline", "a", "b", "c"]
    done = {source: threading.Event() for source in order}
    finished = []

    def evaluate(source: str) -> Training:
        for later in order[order.index(source) + 1 :]:
            assert done[later].wait(timeout=30)
        finished.append(source)
        done[source].set()
        return trained(source)

    outcomes = run(proposals("a", "b", "c"), evaluate)
    assert weights(outcomes) == order
    assert finished == order[::-1]
    assert [outcome.completion and outcome.completion.text for outcome in outcomes] == [None, "a", "b", "c"]
    assert all(0 <= outcome.seconds < 60 for outcome in outcomes)


def test_equal_sources_are_trained_once_and_keep_one_worker_only() -> None:
    """Of two workers one trains what several slots ask for, and the other goes on with the rest."""
    done, calls = threading.Event(), list[str]()

    def evaluate(source: str) -> Training:
        calls.append(source)
        assert source != "same" or done.wait(timeout=30)
        if source == "other":
            done.set()
        return trained(source)

    outcomes = run(proposals("same", "other", "same", "baseline", "same"), evaluate, workers=2)
    assert weights(outcomes) == ["baseline", "same", "other", "same", "baseline", "same"]
    assert sorted(calls) == ["baseline", "other", "same"]


def test_what_gate_or_training_rejects_is_a_value() -> None:
    """A refused answer reaches no trainer; a failed training was admitted and is not sent back. Others go on."""
    llm, calls = FakeLLM(), list[str]()

    def evaluate(source: str) -> Training | Rejection:
        calls.append(source)
        return CRASH if source == "a" else trained(source)

    outcomes = run(proposals("a", "bad", "b"), evaluate, llm=llm)
    assert weights(outcomes) == ["baseline", "b"]
    admitted = Admitted(source="a", profile=PROFILE)
    assert [(one.admitted, one.result) for one in outcomes[1:3]] == [(admitted, CRASH), (None, REFUSAL)]
    assert sorted(calls) == ["a", "b", "baseline"]
    run(proposals("a"), evaluate, llm=llm, repairs=3)
    assert llm.rounds == [3, 1]


def test_longest_that_waits_is_trained_first() -> None:
    """A worker takes the candidate of most FLOPs, so that short ones fill the end of a generation; ties by arrival."""
    flops = {"baseline": 3, "short": 1, "long": 9, "twin": 3}
    asked, order = threading.Event(), []

    class Answering(FakeLLM):
        def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
            """Answer, and tell when all is answered."""
            yield from super().complete(requests)
            asked.set()

    def inspect(source: str) -> Admitted:
        assert asked.wait(timeout=30)
        return Admitted(source=source, profile=replace(PROFILE, flops=flops[source]))

    def evaluate(source: str) -> Training:
        order.append(source)
        return trained(source)

    outcomes = run(proposals("short", "long", "twin"), evaluate, llm=Answering(), inspect=inspect, workers=1)
    assert order == ["long", "baseline", "twin", "short"]
    assert weights(outcomes) == ["baseline", "short", "long", "twin"]


def test_gate_sees_what_the_model_was_asked() -> None:
    """Each answer comes with the user's turns of its own request, in a repair with all of them."""
    seen: list[tuple[str, str]] = []

    def admit(completion: Completion, asked: str) -> Rejection:
        seen.append((completion.text, asked))
        return REFUSAL

    with ThreadPoolExecutor(1) as executor:
        effects = replace(fakes.effects(executor=executor), llm=FakeLLM(), admit=admit)
        list(develop(proposals("a", "b"), effects, repairs=1))
    assert {text for text, _ in seen} == {"a", "b"}
    assert all(asked.startswith(text) for text, asked in seen)
    assert len({len(asked) for _, asked in seen}) == 2


@pytest.mark.parametrize("text", ["a", "b"])
def test_broken_sandbox_passes_through(text: str) -> None:
    """An exception is not a verdict: it reaches the search, and every slot that waited for the same training."""

    def evaluate(source: str) -> Training:
        if source == text:
            raise SandboxError("the zygote is gone")
        return trained(source)

    with pytest.raises(SandboxError, match="the zygote is gone"):
        run(proposals("a", "b", "a", "b"), evaluate)


def test_unreachable_model_passes_through() -> None:
    """A model that fails after some answers ends the generation with its own error."""
    with pytest.raises(LLMError, match="no network"):
        run(proposals("a", "b", "c"), llm=FakeLLM(answers=1))


@pytest.mark.parametrize("workers", [1, 8])
def test_rejected_answers_are_sent_back_together(workers: int) -> None:
    """One round corrects what it can, the next what is left; what is still bad at the end stays rejected."""
    llm = FakeLLM({"bad a": "good a", "bad b": "bad c", "bad c": "good c"})
    outcomes = run(proposals("fine", "bad a", "bad b", "bad d"), llm=llm, repairs=2, workers=workers)
    assert llm.rounds == [4, 3, 2]
    assert weights(outcomes) == ["baseline", "fine", "good a", "good c"]
    said = [[completion.text for completion in outcome.completions] for outcome in outcomes]
    assert said == [[], ["fine"], ["bad a", "good a"], ["bad b", "bad c", "good c"], ["bad d", "bad d", "bad d"]]
    assert [attempt.rejection for attempt in outcomes[3].attempts] == [REFUSAL, REFUSAL]


def test_repairs_end_when_nothing_is_sent_back() -> None:
    """However many a stranger's run.json allows; nothing planned is nothing done."""
    assert [outcome.attempts for outcome in run(proposals("good"), repairs=10**12)] == [(), ()]
    assert run([]) == []
