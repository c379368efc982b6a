"""From proposals to outcomes: the expensive half of a generation, with every effect passed in."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass

from tacevo.gate.admission import Admitted
from tacevo.llm.client import LLM
from tacevo.proposals import Proposal
from tacevo.records import Completion, Rejection, Training

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
class Outcome:
    """What became of a proposal."""

    proposal: Proposal
    #: None for the baseline, which no model was asked for.
    completion: Completion | None
    #: None where the gate turned the answer away.
    admitted: Admitted | None
    result: Training | Rejection
    #: Wall time of gate and training; for people, never for the ledger.
    seconds: float


def develop(proposals: Sequence[Proposal], tools: Tools) -> Iterator[Outcome]:
    """Turn proposals into outcomes, in slot order.

    All requests are made at once; each answer goes through the gate and into training as soon as it arrives, and
    equal sources are trained once.

    Raises:
        LLMError: an answer could not be had.
        SandboxError: the sandbox is broken.
    """
    evaluate = _Once(tools.evaluate)
    futures: dict[int, Future[Outcome]] = {}
    asked = []
    for index, proposal in enumerate(proposals):
        if proposal.request is None:
            futures[index] = tools.executor.submit(_develop_one, proposal, None, tools, evaluate)
        else:
            asked.append((index, proposal.request))
    for position, completion in tools.llm.complete([request for _, request in asked]):
        index = asked[position][0]
        futures[index] = tools.executor.submit(_develop_one, proposals[index], completion, tools, evaluate)
    for index in range(len(proposals)):
        yield futures[index].result()


def _develop_one(proposal: Proposal, completion: Completion | None, tools: Tools, evaluate: Evaluate) -> Outcome:
    """Take one answer through the gate and, where it passes, through training."""
    began = time.perf_counter()
    gated = tools.inspect(proposal.source) if completion is None else tools.admit(completion)
    return Outcome(
        proposal=proposal,
        completion=completion,
        admitted=None if isinstance(gated, Rejection) else gated,
        result=gated if isinstance(gated, Rejection) else evaluate(gated.source),
        seconds=time.perf_counter() - began,
    )


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
            except BaseException as error:  # whatever it is, the waiting thread must hear of it
                answer.set_exception(error)
        return answer.result()
