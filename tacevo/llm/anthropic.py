"""Claude through the official SDK and the Messages API.

The SDK retries rate limits, overload, time-outs and server errors, honouring the server's `retry-after`; what
still fails is a `TransportError` and is not recorded. The key comes from the environment only.
"""

import asyncio
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import cast

import anthropic
from anthropic.types import MessageParam

from tacevo.errors import ConfigError, TransportError
from tacevo.records import Completion, Request

#: Tries of one request before the run gives up; a run continues later from what was recorded.
MAX_RETRIES = 8

#: What no retry and no later run can mend.
_REFUSED = (anthropic.AuthenticationError, anthropic.PermissionDeniedError, anthropic.NotFoundError)

#: Positions and what came of them, from the asking thread to the search.
_Answers = queue.SimpleQueue[tuple[int, Completion | Exception]]


class AnthropicLLM:
    """Answers requests by Claude, up to `concurrency` at once.

    Args:
        connect: makes the SDK's asynchronous client; called for every batch, because a client's connections belong
            to the event loop that opened them.
        concurrency: requests in flight at once.
    """

    def __init__(self, connect: Callable[[], anthropic.AsyncAnthropic], *, concurrency: int) -> None:
        self._connect = connect
        self._concurrency = concurrency

    def complete(self, requests: Sequence[Request]) -> Iterator[tuple[int, Completion]]:
        """Answer every request, in the order of arrival (see `tacevo.llm.client.LLM`).

        Raises:
            ConfigError: the key or the model is refused; asking again cannot help.
            TransportError: a request failed after all retries; the answers to the others were yielded before.
        """
        answers: _Answers = queue.SimpleQueue()
        batch = self._ask_all(self._connect(), requests, answers)
        asking = threading.Thread(target=asyncio.run, args=(batch,), daemon=True)
        asking.start()
        failed: list[Exception] = []
        for _ in requests:
            position, answer = answers.get()
            if isinstance(answer, Exception):
                failed.append(answer)
            else:
                yield position, answer
        asking.join()
        if any(isinstance(error, _REFUSED) for error in failed):
            raise ConfigError(f"llm=anthropic: the server refuses the key or the model: {failed[0]}") from failed[0]
        if failed:
            raise TransportError(
                f"{len(failed)} of {len(requests)} requests failed after up to {MAX_RETRIES} retries, the first with "
                f"{type(failed[0]).__name__}: {failed[0]}; give the same command again: what came is recorded"
            ) from failed[0]

    async def _ask_all(self, client: anthropic.AsyncAnthropic, requests: Sequence[Request], answers: _Answers) -> None:
        places = asyncio.Semaphore(self._concurrency)

        async def ask(position: int, request: Request) -> None:
            async with places:
                try:
                    answers.put((position, await _ask(client, request)))
                except Exception as error:  # whatever it is, the waiting search must hear of it
                    answers.put((position, error))

        async with client:
            await asyncio.gather(*(ask(position, request) for position, request in enumerate(requests)))


async def _ask(client: anthropic.AsyncAnthropic, request: Request) -> Completion:
    message = await client.messages.create(
        model=request.model,
        system=request.system,
        messages=[cast(MessageParam, {"role": turn.role, "content": turn.content}) for turn in request.messages],
        max_tokens=request.max_tokens,
        extra_body={"temperature": request.temperature},  # newer models take none, so the SDK names none
    )
    return Completion(
        text="".join(block.text for block in message.content if block.type == "text"),
        model=message.model,
        stop_reason=message.stop_reason or "end_turn",
        input_tokens=message.usage.input_tokens,
        output_tokens=message.usage.output_tokens,
    )
