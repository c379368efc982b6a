"""The development of proposals into outcomes: the expensive half of a generation, with every effect passed in."""

import heapq
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

from tacevo.errors import CacheMissError
from tacevo.evolution.prompts import repair_request
from tacevo.evolution.proposals import Proposal
from tacevo.profile import Admitted
from tacevo.records import Completion, Operator, Rejection, Request, Training

#: Trains a source; a candidate that fails is a value.
Evaluate = Callable[[str], Training | Rejection]


class LLM(Protocol):
    """Anything that answers requests."""

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request, as many at once as the provider allows; equal requests are not merged.

        Yields:
            Pairs (position in `requests`, completion) in the order of arrival, each position exactly once.

        Raises:
            LLMError: a request failed after all retries; the answers yielded before it remain good.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """The effects of a search; each answers from a store what it answered before."""

    llm: LLM
    #: The gate, for a model's answer and what it was asked.
    admit: Callable[[Completion, str], Admitted | Rejection]
    #: The gate, for the task's baseline.
    inspect: Callable[[str], Admitted | Rejection]
    #: The gate's probe alone, for a source that the gate admitted before: a given network.
    measure: Callable[[str], Admitted | Rejection]
    evaluate: Evaluate
    #: Names the training of a source in its store.
    evaluation_key: Callable[[str], str]
    executor: Executor
    #: The processor time, in seconds, of all candidates that the calling thread has waited for; it only grows.
    cpu_seconds: Callable[[], float]
    #: Applies the edits of an answer to the network that it may be edits of; what comes is for `admit`. Without it, no
    #: answer is edits.
    edited: Callable[[Completion, str], Completion | Rejection] = lambda completion, _: completion


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """An answer that the gate rejected and that was sent back."""

    completion: Completion
    rejection: Rejection


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The outcome of a proposal."""

    proposal: Proposal
    #: The last answer; None for the baseline and a given network, which no model was asked for.
    completion: Completion | None
    #: The admitted candidate; None where the gate rejected the answer.
    admitted: Admitted | None
    #: The training, or the rejection where there is none; None of a skipped candidate.
    result: Training | Rejection | None
    #: Wall time of gate and training; for people, never for the ledger.
    seconds: float
    #: Processor time of the training, 0 of one that was recalled; for people, too.
    cpu_seconds: float
    #: The answers before it, each of them sent back with the gate's reason.
    attempts: tuple[Attempt, ...] = ()
    #: The key of the training in its store; None where nothing was trained.
    evaluation: str | None = None

    @property
    def completions(self) -> tuple[Completion, ...]:
        """Every answer to the proposal, in order."""
        last = () if self.completion is None else (self.completion,)
        return (*(attempt.completion for attempt in self.attempts), *last)


def develop(
    proposals: Sequence[Proposal],
    effects: Effects,
    *,
    repairs: int,
    skips: Callable[[Admitted], bool] | None = None,
) -> Iterator[Outcome]:
    """Turn proposals into outcomes, in slot order.

    All requests are made at once, and each answer goes through the gate as soon as it arrives. Of the admitted
    candidates that wait, the one with most FLOPs is trained first, so that a generation does not end with one worker at
    a long training and the others idle; equal sources are trained once. What the gate rejected is sent back together
    when the gate is done, up to `repairs` times. An answer of the model that `skips` names is not trained.

    Raises:
        LLMError: a request failed after all retries.
        SandboxError: the sandbox is broken.
    """
    trainings = _Trainings(effects, skips)
    judged: dict[int, Future[_Slot]] = {}
    asked: dict[int, _Slot] = {}
    for index, proposal in enumerate(proposals):
        slot = _Slot(proposal=proposal, request=proposal.request)
        if proposal.request is None:
            judged[index] = effects.executor.submit(_judge, slot, None, effects, trainings)
        else:
            asked[index] = slot
    for round_ in range(1 + repairs):
        if round_ > 0:
            asked = _sent_back({index: judged[index].result() for index in asked})
        if not asked:
            break
        for index, completion in _answers(asked, effects.llm):
            judged[index] = effects.executor.submit(_judge, asked[index], completion, effects, trainings)
    for index in range(len(proposals)):
        yield _outcome(judged[index].result(), effects.evaluation_key)


def _answers(asked: Mapping[int, "_Slot"], llm: LLM) -> Iterator[tuple[int, Completion]]:
    """Yield each answer with its index among the proposals.

    Raises:
        CacheMissError: a replay, which answers in order, has no answer to the next one; the message names its slot.
    """
    indices = list(asked)
    answered = 0
    try:
        for position, completion in llm.complete([slot.request for slot in asked.values() if slot.request is not None]):
            answered += 1
            yield indices[position], completion
    except CacheMissError as error:
        _name_slot(error, asked[indices[answered]].proposal)
        raise


def _name_slot(error: CacheMissError, proposal: Proposal) -> None:
    error.place = f"generation {proposal.generation}, slot {proposal.slot}, {error.place}"


def _sent_back(judged: Mapping[int, "_Slot"]) -> dict[int, "_Slot"]:
    """Return the slots whose rejected answers can be sent back, each with the request that does it."""
    again: dict[int, _Slot] = {}
    for index, slot in judged.items():
        if slot.request is None or slot.completion is None or not isinstance(slot.gated, Rejection):
            continue
        repair = repair_request(slot.request, slot.completion.text, slot.gated, edits=slot.proposal.edited is not None)
        if repair is not None:
            attempt = Attempt(completion=slot.completion, rejection=slot.gated)
            again[index] = replace(slot, request=repair, attempts=(*slot.attempts, attempt))
    return again


class _Trained(NamedTuple):
    """The result of a training, and its wall and processor time in seconds."""

    result: Training | Rejection
    seconds: float
    cpu_seconds: float


class _Trainings:
    """The trainings of a generation: each source once; of those that wait, the one with most FLOPs first."""

    def __init__(self, effects: Effects, skips: Callable[[Admitted], bool] | None) -> None:
        self._effects = effects
        self._skips = skips
        self._lock = threading.Lock()
        self._known: dict[str, Future[_Trained]] = {}
        #: A heap of what no worker has begun: FLOPs, negative; a number that decides ties; the source.
        self._waiting: list[tuple[int, int, str]] = []

    def add(self, admitted: Admitted, proposal: Proposal) -> Future[_Trained] | None:
        """Have a candidate trained; return what will come of it. Equal sources share one training.

        Nothing comes of a skipped one. What a user gave is not skipped.
        """
        if proposal.request is not None and self._skips is not None and self._skips(admitted):
            return None
        with self._lock:
            if admitted.source in self._known:
                return self._known[admitted.source]
            answer = self._known[admitted.source] = Future()
            heapq.heappush(self._waiting, (-admitted.profile.training_flops, len(self._known), admitted.source))
        self._effects.executor.submit(self._train_longest)
        return answer

    def _train_longest(self) -> None:
        with self._lock:
            *_, source = heapq.heappop(self._waiting)
        began, spent = time.perf_counter(), self._effects.cpu_seconds()
        try:
            result = self._effects.evaluate(source)
        except BaseException as error:  # who waits for the answer must raise it
            self._known[source].set_exception(error)
        else:
            took = time.perf_counter() - began, self._effects.cpu_seconds() - spent
            self._known[source].set_result(_Trained(result, *took))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Slot:
    """The state of a slot of a generation: what is asked, what was answered, what the gate made of it."""

    proposal: Proposal
    #: The request to a model; None for the baseline and a given network.
    request: Request | None
    #: The answers that were sent back before.
    attempts: tuple[Attempt, ...] = ()
    #: Wall time of the gate, for these too.
    seconds: float = 0.0
    completion: Completion | None = None
    #: The gate's verdict; None before it has judged.
    gated: Admitted | Rejection | None = None
    #: The training of an admitted candidate, under way or done; None of one that was not admitted, or is skipped.
    training: Future[_Trained] | None = None


def _judge(slot: _Slot, completion: Completion | None, effects: Effects, trainings: _Trainings) -> _Slot:
    """Take an answer, or a given source, through the gate and, where it passes, have it trained."""
    began = time.perf_counter()
    try:
        gated = _gate(slot, completion, effects)
    except CacheMissError as error:
        _name_slot(error, slot.proposal)
        raise
    return replace(
        slot,
        completion=completion,
        gated=gated,
        training=None if isinstance(gated, Rejection) else trainings.add(gated, slot.proposal),
        seconds=slot.seconds + time.perf_counter() - began,
    )


def _gate(slot: _Slot, completion: Completion | None, effects: Effects) -> Admitted | Rejection:
    """Judge an answer, the baseline, or a source that was admitted once.

    The policy is not asked about that source again: a model may have written it for another version of Python, and a
    replay on this one must not parse it.
    """
    proposal = slot.proposal
    if completion is not None:
        messages = () if slot.request is None else slot.request.messages
        asked = "\n".join(message.content for message in messages if message.role == "user")
        noteless = completion if proposal.telling is None else proposal.telling.without_note(completion)
        answer = noteless if proposal.edited is None else effects.edited(noteless, proposal.edited)
        return answer if isinstance(answer, Rejection) else effects.admit(answer, asked)
    if proposal.operator is Operator.baseline:
        return effects.inspect(proposal.source)
    return effects.measure(proposal.source)


def _outcome(slot: _Slot, evaluation_key: Callable[[str], str]) -> Outcome:
    """Wait for the training of what the gate admitted."""
    try:
        trained = None if slot.training is None else slot.training.result()
    except CacheMissError as error:
        _name_slot(error, slot.proposal)
        raise
    admitted, rejection = (None, slot.gated) if isinstance(slot.gated, Rejection) else (slot.gated, None)
    return Outcome(
        proposal=slot.proposal,
        completion=slot.completion,
        admitted=admitted,
        result=rejection if trained is None else trained.result,
        seconds=slot.seconds + (0.0 if trained is None else trained.seconds),
        cpu_seconds=0.0 if trained is None else trained.cpu_seconds,
        attempts=slot.attempts,
        evaluation=None if admitted is None or trained is None else evaluation_key(admitted.source),
    )
