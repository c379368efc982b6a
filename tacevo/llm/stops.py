"""The reason why a server ended an answer, in the words of the Messages API, which the gate knows; pure.

Servers have dozens of words for it. They are compared without case and signs, so `MAX_TOKENS`, `max-tokens` and
`FinishReason.MAX_TOKENS` are one. A word that nobody knows counts as that of an answer that may be cut off.
"""

import re
from collections.abc import Mapping

from tacevo.llm.retry import Fault, FaultError, FaultKind
from tacevo.records import Json

#: The reason of an answer whose server gave none that is known; the gate takes it for one that may be cut off.
UNKNOWN = "unknown"

#: The words for an answer that the model ended itself, or for no reason, each with the reason that is recorded.
_FINISHED = {
    **dict.fromkeys(["stop", "endturn", "end", "endid", "eos", "eot", "eosfound", "complete", "completed"], "end_turn"),
    **dict.fromkeys(["finish", "finished", "done", "success", "succeeded", "null", "none"], "end_turn"),
    "word": "stop_sequence",
    "tooluse": "tool_use",
    "toolcall": "tool_calls",
    "toolcalls": "tool_calls",
    "functioncall": "function_call",
}

#: The beginnings of such words as name the token or the text at which the model ended.
_ENDED_BY = {"eos": "end_turn", "eot": "end_turn", "endof": "end_turn"} | dict.fromkeys(
    ["stopsequence", "stopstring", "stopstr", "stoptoken", "stopword"], "stop_sequence"
)

#: The parts of the words for the other ends; the first that is found counts: `error_limit` tells of a limit.
_REFUSED = re.compile(
    "filter|safety|refus|polic|block|moderat|prohibit|sensitive|guardrail|flag|toxic|recitation|spii|violat"
)
_CUT_OFF = re.compile("length|max|(?<!rate)limit|token|context|truncat")
_FAILED = re.compile(
    "error|fail|abort|cancel|timeout|timedout|insufficient|overload|unavailable|interrupt|exception|ratelimit"
    "|malformed|crash|unload|preempt|disconnect|userstop"
)

#: The prefix of the word where a server writes the name of a constant.
_NAME = re.compile("^(finish|stop)?reason(?=.)")


def stop_reason_of(said: Json) -> str:
    """Return why an answer ended: `end_turn` also where the server does not say.

    Args:
        said: the word, or an object whose `type` it is, as some servers have it.

    Raises:
        FaultError: the server says that it failed, so what it sent is not the model's answer.
    """
    if isinstance(said, Mapping):
        said = said.get("type", said.get("reason"))
    if not isinstance(said, str) or not said.strip():
        return "end_turn"
    word = _NAME.sub("", re.sub("[^a-z0-9]", "", said.casefold()))
    finished = [reason for start, reason in _ENDED_BY.items() if word.startswith(start)]
    if word in _FINISHED or finished:
        return _FINISHED.get(word) or finished[0]
    if _REFUSED.search(word):
        return "refusal"
    if _CUT_OFF.search(word):
        of_context = "context" in word or "model" in word
        return "model_context_window_exceeded" if of_context else "max_tokens"
    if _FAILED.search(word):
        message = f"the server says that its answer failed: {' '.join(said.split())[:60]}"
        raise FaultError(Fault(kind=FaultKind.passing, message=message))
    return UNKNOWN
