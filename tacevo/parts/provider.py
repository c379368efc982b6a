"""Providers of answers: what `llm.provider` chooses."""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from tacevo.records import Completion, Request

#: Stores the answer to a request, and returns it as it was stored; may be called by several threads at once.
Keep = Callable[[Request, Completion], Completion]


class Provider(Protocol):
    """Answers requests that are not recorded: what `llm.provider=NAME` stands for.

    A provider of your own is a frozen dataclass. A field that has the name of a setting of `llm` (`model`, `base_url`,
    `concurrency`, ...) gets that setting; each other field is a setting of the provider's own, `parts.NAME.FIELD`, and
    enters the key of every answer. A replay never asks it.
    """

    def complete(self, requests: Sequence[Request], keep: Keep) -> Iterator[tuple[int, Completion]]:
        """Answer different requests, in any order.

        Args:
            requests: each with its system prompt, messages, temperature (None: send none), token limit and further
                settings.
            keep: is called with each answer as soon as it arrives, so that nothing that was paid for is lost.

        Yields:
            The position of a request, and what `keep` returned.

        Raises:
            LLMError: a request got no answer, and asking again cannot help.
        """
        ...
