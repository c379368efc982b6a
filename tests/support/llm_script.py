"""What the test server answers: sound answers, and every way to misbehave, on command or by a plan from a seed.

A command stands in the last turn of a request: `[fault NAME]`, or `[fault NAME xN]` for its first N tries.

    429 429_bare 500 503 529 408 409    that status; a plain 429 comes with `retry-after`, the bare one without
    401 402 403 404 413 ...             any other status, too
    slow reset malformed shapeless      late; cut off in mid-answer; no JSON; JSON of another shape
    too_long filtered invalid credit    status 400 with the words that the real servers use
    refusal max_tokens empty            answers of those kinds
    stopped                             an answer that is marked as failed
    wrong_model echo                    an answer by another model; an answer, or a refusal, that repeats the key
    errored expired canceled            of one request in a batch
    unknown                             status 404: there is no such model
"""

import hashlib
import json
import random
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from llm_models import THOUGHT_TOKENS, Model

#: Faults that pass, which a plan draws from.
PASSING = ("429", "429_bare", "500", "529", "slow", "reset", "malformed")

#: What a batch can make of a request, beside an answer.
UNANSWERED = ("errored", "expired", "canceled")

#: Messages of status 400, as real servers write them.
REFUSALS = {
    "too_long": "prompt is too long: 250000 tokens > 200000 maximum",
    "filtered": "Output blocked by content filtering policy",
    "invalid": "messages.0: this is not understood",
    "credit": "Your credit balance is too low to access the API. Please go to Plans & Billing.",
}

_COMMAND = re.compile(r"\[fault (\w+)(?: x(\d+))?\]")

Body = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Script:
    """How a server behaves."""

    seed: int = 0
    #: Part of the tries that fail by plan.
    rate: float = 0.0
    #: Seconds before every answer, and before a slow one.
    delay: float = 0.0
    slow: float = 0.05
    #: What a plain 429 asks to wait, in seconds.
    retry_after: float = 0.01
    #: Writes the answer to a body.
    answer: Callable[[Body], str] | None = None
    #: Says of what kind that answer is: `max_tokens`, `refusal`, or empty where it is whole.
    kind: Callable[[Body], str] | None = None
    #: Settings that the models refuse, one a time, as real ones do.
    refused: tuple[str, ...] = ()
    #: What every request is refused with; empty where none is.
    words: str = ""
    #: Settings of which the models take one only, as real ones do.
    exclusive: tuple[str, ...] = ()
    #: The models that there are, and that are listed; empty for a server that takes any name and has no list.
    models: tuple[str, ...] = ()
    #: The models that are answered as, by name (tests/support/llm_models.py); they count as models that there are.
    like: Mapping[str, Model] = field(default_factory=dict)
    #: The status and the body with which the Models API answers for a model, whatever the model is.
    told: tuple[int, str] | None = None
    #: How often a batch is looked at before it has ended.
    polls: int = 1
    #: Where the server stops answering, once: `submitted` (before a batch exists), `created`, `polled` or `results`.
    stall: str = ""
    #: Where it cuts the connection, once; the same places.
    cut: str = ""
    #: What is wrong with a batch's results: `lacking` their last line, or `textless` in it; empty where nothing is.
    results: str = ""
    #: How many single requests must have been open at once before any is answered.
    together: int = 0
    #: How many tries of every single request fail first, with status 500.
    failing: int = 0
    #: How many calls about batches get this status first.
    batch_faults: int = 0
    batch_status: int = 529

    def fault(self, body: Body, tried: int) -> str:
        """Name the fault of a try, counted from 1, or the kind of its answer; empty where it is answered whole."""
        command = _COMMAND.search(text_of(body))
        if command is not None:
            return command[1] if command[2] is None or tried <= int(command[2]) else ""
        if tried <= self.failing:
            return "500"
        draw = random.Random(f"{self.seed} {key_of(body)} {tried}")
        if draw.random() < self.rate:
            return draw.choice(PASSING)
        return "" if self.kind is None else self.kind(body)

    def refusal(self, body: Body) -> str:
        """Say which setting of a body the models refuse; empty where none."""
        if self.words:
            return self.words
        model = self.like.get(body["model"])
        if model is not None and (words := model.refusal(body)):
            return words
        named = [name for name in self.refused if name in body]
        if named:
            return f"`{named[0]}` is not supported with this model"
        both = " and ".join(f"`{name}`" for name in self.exclusive)
        together = self.exclusive and all(name in body for name in self.exclusive)
        return f"{both} cannot both be specified for this model. Please use only one." if together else ""

    def lacks(self, body: Body, fault: str) -> bool:
        """Say whether there is no such model as a body names."""
        known = {*self.models, *self.like}
        return fault == "unknown" or (bool(known) and body["model"] not in known)

    def thoughts(self, body: Body) -> int | None:
        """Say how many tokens a model thinks before it answers a body; None where it does not think."""
        model = self.like.get(body["model"])
        return THOUGHT_TOKENS if model is not None and model.thinks(body) else None

    def text(self, body: Body, fault: str, login: str) -> str:
        """Write the answer's text."""
        if fault in {"refusal", "empty"}:
            return ""
        if fault == "echo":
            return f"you are {login}"
        return self.answer(body) if self.answer is not None else f"{text_of(body)}!"


def text_of(body: Body) -> str:
    """Return the last turn of a request."""
    return str(body["messages"][-1]["content"])


def key_of(body: Body) -> str:
    """Name a request by all that was asked; how the answer is to come is no part of it."""
    asked = {name: value for name, value in body.items() if name != "stream"}
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def message(body: Body, text: str, fault: str, thoughts: int | None = None) -> Body:
    """Write an answer of the Messages API, with a block of thinking of so many tokens before it."""
    block = {"type": "thinking", "thinking": "", "signature": "c2lnbmVk"}
    thinking: Body = {} if thoughts is None else {"output_tokens_details": {"thinking_tokens": thoughts}}
    reason = {"refusal": fault, "max_tokens": fault, "stopped": "error"}.get(fault, "end_turn")
    return {
        "id": f"msg_{key_of(body)[:24]}",
        "type": "message",
        "role": "assistant",
        "model": "another-model" if fault == "wrong_model" else f"{body['model']}-dated",
        "content": [*([] if thoughts is None else [block]), {"type": "text", "text": text}],
        "stop_reason": reason,
        "stop_sequence": None,
        "usage": {"input_tokens": 11, "output_tokens": 7 + (thoughts or 0), **thinking},
    }


def chat(body: Body, text: str, fault: str) -> Body:
    """Write an answer of the chat-completions API."""
    reason = {"refusal": "content_filter", "max_tokens": "length", "stopped": "error"}.get(fault, "stop")
    return {
        "id": f"chatcmpl-{key_of(body)[:24]}",
        "object": "chat.completion",
        "created": 0,
        "model": "another-model" if fault == "wrong_model" else f"{body['model']}-dated",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": reason}],
        "usage": {"prompt_tokens": 11, "completion_tokens": 7, "total_tokens": 18},
    }


def error(kind: str, words: str) -> Body:
    """Write an error, in a shape that both kinds of API share."""
    return {"type": "error", "error": {"type": kind, "message": words}}


def outcome_in_batch(script: Script, body: Body, login: str) -> Body:
    """Write what becomes of one request of a batch."""
    fault = script.fault(body, 1)
    if fault == "errored":
        return {"type": "errored", "error": error("api_error", "internal server error")}
    if script.lacks(body, fault):
        return {"type": "errored", "error": error("not_found_error", f"model: {body['model']}")}
    if fault in UNANSWERED:
        return {"type": fault}
    words = REFUSALS.get(fault) or script.refusal(body)
    if words:
        return {"type": "errored", "error": error("invalid_request_error", words)}
    answer = message(body, script.text(body, fault, login), fault, script.thoughts(body))
    return {"type": "succeeded", "message": answer}
