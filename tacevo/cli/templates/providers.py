"""Providers: who answers the requests of a search."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tacevo.parts.provider import Keep, Provider
from tacevo.records import Completion, Request


@dataclass(frozen=True)
class Mine(Provider):
    """Answers with the parent's class and a remark."""

    #: The name that records have; a search sets it by `llm.model`.
    model: str = "mine"
    remark: str = "unchanged"

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer requests; each answer is kept as soon as it is there, so that none is paid for twice."""
        for position, request in enumerate(requests):
            answer = Completion(
                text=self._answer(request), model=self.model, stop_reason="end_turn", input_tokens=0, output_tokens=0
            )
            yield position, keep(request, answer)

    def _answer(self, request: Request) -> str:
        """Return the text of an answer; `request.system`, `temperature` and `max_tokens` are for a model."""
        parent = re.findall(r"```python\n(.*?)\n?```", request.messages[0].content, re.DOTALL)[0]
        return f"```python\n{parent}\n# {self.remark}, draw {request.draw}\n```"
