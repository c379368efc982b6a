"""From proposals to outcomes: the expensive half of a generation, with every effect passed in."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace

from tacevo.errors import CacheMissError
from tacevo.profile import Admitted
from tacevo.records import Completion, Rejection, Request, Training, to_json
from tacevo.search.effects import LLM
from tacevo.search.lines import CandidateLine, RepairedAnswer
from tacevo.search.proposals import Proposal, repair_request
from tacevo.storage.canonical import content_hash

#: Trains a source; a candidate that fails is a value.
Evaluate = Callable[[str], Training | Rejection]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tools:
    """The effects of a search; each answers from a store what it answered before."""

    llm: LLM
    #: The gate, for a model's answer.
    admit: Callable[[Completion], Admitted | Rejection]
    #: The gate, for a source that is given.
    inspect: Callable[[str], Admitted | Rejection]
    evaluate: Evaluate
    #: Names a source's evaluation in its store.
    evaluation_key: Callable[[str], str]
    executor: Executor


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """An answer that the gate rejected and that was sent back."""

    completion: Completion
    rejection: Rejection


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a proposal."""

    proposal: Proposal
    #: The last answer; None for the baseline, which no model was asked for.
    completion: Completion | None
    #: None where the gate rejected the answer.
    admitted: Admitted | None
    result: Training | Rejection
    #: Wall time of gate and training; for people, never for the ledger.
    seconds: float
    #: The answers before it, each of them sent back with the gate's reason.
    attempts: tuple[Attempt, ...] = ()

    @property
    def completions(self) -> tuple[Completion, ...]:
        """Every answer to the proposal, in order."""
        last = () if self.completion is None else (self.completion,)
        return (*(attempt.completion for attempt in self.attempts), *last)


def develop(proposals: Sequence[Proposal], tools: Tools, *, repairs: int = 0) -> Iterator[Outcome]:
    """Turn proposals into outcomes, in slot order.

    All requests are made at once; each answer goes through the gate and into training as soon as it arrives, and
    equal sources are trained once. What the gate rejected is sent back together when all of that is
    done, training included, up to `repairs` times.

    Args:
        proposals: the slots of a generation.
        tools: the effects.
        repairs: how often an answer may be corrected.

    Raises:
        LLMError: a request failed after all retries.
        SandboxError: the sandbox is broken.
    """
    tools = replace(tools, evaluate=_Once(tools.evaluate))
    futures: dict[int, Future[Outcome]] = {}
    asked: dict[int, Request] = {}
    for index, proposal in enumerate(proposals):
        if proposal.request is None:
            futures[index] = tools.executor.submit(_develop_one, proposal, None, tools)
        else:
            asked[index] = proposal.request
    _ask(asked, proposals, tools, futures)
    for _ in range(repairs):
        asked = _sent_back(asked, futures)
        _ask(asked, proposals, tools, futures)
    for index in range(len(proposals)):
        yield futures[index].result()


def _ask(
    asked: Mapping[int, Request], proposals: Sequence[Proposal], tools: Tools, futures: dict[int, Future[Outcome]]
) -> None:
    """Make requests at once, and develop each answer as it arrives; one of an earlier round becomes an attempt."""
    for index, completion in _answers(asked, proposals, tools.llm):
        before = futures[index].result() if index in futures else None
        futures[index] = tools.executor.submit(_develop_one, proposals[index], completion, tools, before)


def _answers(asked: Mapping[int, Request], proposals: Sequence[Proposal], llm: LLM) -> Iterator[tuple[int, Completion]]:
    """Yield each answer with its place among the proposals.

    Raises:
        CacheMissError: a replay, which answers in order, has no answer to the next one; the message names its slot.
    """
    places = list(asked)
    answered = 0
    try:
        for position, completion in llm.complete(list(asked.values())):
            answered += 1
            yield places[position], completion
    except CacheMissError as error:
        _name_slot(error, proposals[places[answered]])
        raise


def _name_slot(error: CacheMissError, proposal: Proposal) -> None:
    error.place = f"generation {proposal.generation}, slot {proposal.slot}, {error.place}"


def _sent_back(asked: Mapping[int, Request], futures: Mapping[int, Future[Outcome]]) -> dict[int, Request]:
    """Wait until a round is judged and trained, and write the requests that send rejected ones back."""
    again: dict[int, Request] = {}
    for index, request in asked.items():
        outcome = futures[index].result()
        if outcome.admitted is None and outcome.completion is not None and isinstance(outcome.result, Rejection):
            repair = repair_request(request, outcome.completion.text, outcome.result)
            if repair is not None:
                again[index] = repair
    return again


def _develop_one(
    proposal: Proposal, completion: Completion | None, tools: Tools, before: Outcome | None = None
) -> Outcome:
    """Take one answer through the gate and, where it passes, through training."""
    began = time.perf_counter()
    try:
        gated = tools.inspect(proposal.source) if completion is None else tools.admit(completion)
        result = gated if isinstance(gated, Rejection) else tools.evaluate(gated.source)
    except CacheMissError as error:
        _name_slot(error, proposal)
        raise
    return Outcome(
        proposal=proposal,
        completion=completion,
        admitted=None if isinstance(gated, Rejection) else gated,
        result=result,
        seconds=time.perf_counter() - began + (0.0 if before is None else before.seconds),
        attempts=() if before is None else _with_attempt(before),
    )


def _with_attempt(before: Outcome) -> tuple[Attempt, ...]:
    """Turn an outcome whose answer was sent back into the attempts of the one that follows."""
    if before.completion is None or not isinstance(before.result, Rejection):
        raise ValueError(f"{before.proposal.id} has no rejected answer that could have been sent back")
    return (*before.attempts, Attempt(completion=before.completion, rejection=before.result))


class _Once:
    """Evaluates equal sources of one generation once; a later asker waits for the first one's answer."""

    def __init__(self, evaluate: Evaluate) -> None:
        self._evaluate = evaluate
        self._lock = threading.Lock()
        self._answers: dict[str, Future[Training | Rejection]] = {}

    def __call__(self, source: str) -> Training | Rejection:
        with self._lock:
            first = source not in self._answers
            answer = self._answers.setdefault(source, Future())
        if first:
            try:
                answer.set_result(self._evaluate(source))
            except BaseException as error:  # the waiting thread must raise it, too
                answer.set_exception(error)
        return answer.result()


def begun(outcome: Outcome, *, names_dropped: bool) -> CandidateLine:
    """Begin a candidate's line with what was asked and what the model said.

    Args:
        outcome: of the candidate.
        names_dropped: whether the line names the sampling settings that were not sent.
    """
    proposal, completion = outcome.proposal, outcome.completion
    return CandidateLine(
        generation=proposal.generation,
        slot=proposal.slot,
        id=proposal.id,
        operator=proposal.operator,
        parents=proposal.parents,
        prompt=proposal.prompt,
        request=None if proposal.request is None else content_hash(to_json(proposal.request)),
        temperature=None if proposal.request is None else proposal.request.temperature,
        answer=None if completion is None else content_hash(completion.content()),
        dropped=_dropped(completion, names_dropped),
        repairs=tuple(
            RepairedAnswer(
                answer=content_hash(attempt.completion.content()),
                stage=attempt.rejection.stage,
                reason=attempt.rejection.reason,
                dropped=_dropped(attempt.completion, names_dropped),
            )
            for attempt in outcome.attempts
        ),
    )


def _dropped(completion: Completion | None, names_dropped: bool) -> tuple[str, ...]:
    return completion.dropped if completion is not None and names_dropped else ()
