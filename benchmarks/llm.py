"""Asking a model through the whole way to the store, beside the plain SDK in a loop; and the memory of many requests.

The server is the one of the tests, in a process of its own; it answers after `DELAY` seconds, quicker than any model.
"""

import asyncio
import contextlib
import itertools
import json
import os
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from pathlib import Path

import anthropic

from benchmarks.timing import Figure, medians, report, resident
from tacevo.llm.anthropic import connect
from tacevo.llm.failures import Models
from tacevo.llm.hosted import HostedLLM
from tacevo.llm.recording import RecordingLLM
from tacevo.records import ChatMessage, Request
from tacevo.storage.store import Store

CONCURRENCY = 64
DELAY = 0.25

_SERVER = Path(__file__).parents[1] / "tests" / "support" / "llm_server.py"


def asking(*, count: int = 1_000, rounds: int = 3) -> Figure:
    """Ask 1,000 things, 64 at once, and store each answer durably; the peer is the plain SDK, which stores nothing."""
    with _serving() as url, tempfile.TemporaryDirectory() as folder:
        stores = (Store(Path(folder) / str(number), "completions") for number in itertools.count())
        requests = [_request(number) for number in range(count)]
        rivals = {
            f"recorded, {CONCURRENCY} in flight": lambda: _ask(url, next(stores), requests, CONCURRENCY),
            "plain SDK": lambda: asyncio.run(_ask_plainly(url, requests)),
        }
        return report("asking a model", medians(rivals, rounds=rounds), unit="requests", count=count)


def memory_of_many(*, many: int = 10_000) -> Figure:
    """Return the memory that 10,000 requests in flight need, above the process that is about to ask them.

    The server answers none of them before it has them all.
    """
    script = """
        import json, sys
        from pathlib import Path
        from benchmarks.llm import peak_of_many
        print(json.dumps(peak_of_many(*sys.argv[1:3], Path(sys.argv[3]), int(sys.argv[4]))))
    """
    with _serving() as first, _serving(together=many) as url, tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", textwrap.dedent(script), first, url, folder, str(many)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    before, peak = json.loads(done.stdout)
    return Figure(
        title="peak memory", name=f"{many:,} requests in flight, above {before:.0f} MB", value=peak - before, unit="MB"
    )


def peak_of_many(first: str, url: str, root: Path, many: int) -> tuple[float, float]:
    """Ask very many things at once; return the resident memory before, and its peak, in MB (1,000,000 bytes).

    Args:
        first: a server that is asked one thing, so that everything is loaded.
        url: the server of the rest.
        root: where the answers are stored.
        many: how many requests.
    """
    requests = [_request(number) for number in range(many)]
    _ask(first, Store(root / "first", "completions"), requests[:1], 1)
    before = resident("VmRSS")
    _ask(url, Store(root / "rest", "completions"), requests, many)
    return before, resident("VmHWM")


def _request(number: int) -> Request:
    """Make a request of the length of a mutation's."""
    messages = (
        ChatMessage(role="user", content=f"Variant {number} of\n" + "        self.conv = nn.Conv2d(32, 64, 3)\n" * 60),
    )
    return Request(
        model="model-x", system="Write a network.", messages=messages, temperature=0.5, max_tokens=4096, draw=number
    )


def _ask(url: str, store: Store, requests: list[Request], concurrency: int) -> None:
    llm = HostedLLM(lambda: connect(url, concurrency), concurrency=concurrency, models=Models("llm=anthropic"))
    if len(list(RecordingLLM(llm, store).complete(requests))) != len(requests):
        raise RuntimeError("an answer is missing")


async def _ask_plainly(url: str, requests: list[Request]) -> None:
    places = asyncio.Semaphore(CONCURRENCY)
    async with anthropic.AsyncAnthropic(base_url=url) as client:

        async def ask(request: Request) -> None:
            async with places:
                await client.messages.create(
                    model=request.model,
                    system=request.system,
                    max_tokens=request.max_tokens,
                    messages=[{"role": "user", "content": request.messages[0].content}],
                    extra_body={"temperature": request.temperature},
                )

        await asyncio.gather(*(ask(request) for request in requests))


@contextlib.contextmanager
def _serving(*, together: int = 0) -> Iterator[str]:
    os.environ.setdefault("ANTHROPIC_API_KEY", "no-key-for-a-server-of-our-own")
    command = [sys.executable, str(_SERVER), "--delay", str(DELAY), "--together", str(together)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            yield (server.stdout.readline() if server.stdout is not None else "").strip()
        finally:
            server.kill()
