"""The one interface between the search and what writes networks."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from tacevo.records import Completion, Request


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
