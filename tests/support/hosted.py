"""Providers that talk to the test server."""

from collections.abc import Callable
from pathlib import Path

from asked import request

from tacevo.llm import anthropic, openai
from tacevo.llm.batches import BatchLLM
from tacevo.llm.failures import Models
from tacevo.llm.hosted import HostedLLM, Server
from tacevo.llm.retry import Patience
from tacevo.storage.canonical import value_at
from tacevo.storage.store import Store

#: Tries as often as a stormy server needs, without waiting long.
PATIENCE = Patience(tries=40, first=0.002, longest=0.05)

#: Three tries, almost without waits.
QUICK = Patience(tries=3, first=0.001, longest=0.01)

#: The providers, by the names of their tests.
PROVIDERS: dict[str, tuple[Callable[[str | None, int], Server], str]] = {
    "anthropic": (anthropic.connect, ""),
    "openai": (openai.connect, "/v1"),
}


def hosted(
    url: str,
    provider: str = "anthropic",
    *,
    concurrency: int = 8,
    patience: Patience = PATIENCE,
    models: Models | None = None,
) -> HostedLLM:
    """Make the LLM that talks to a server; the key is to stand in the environment."""
    connect, path = PROVIDERS[provider]
    return HostedLLM(
        lambda: connect(url + path, concurrency),
        concurrency=concurrency,
        patience=patience,
        models=models or Models(f"llm={provider}"),
    )


def batched(url: str, root: Path) -> BatchLLM:
    """Make the LLM that submits batches to a server; the key is to stand in the environment."""
    return BatchLLM(
        lambda: anthropic.connect_batches(url),
        store=Store(root, "completions"),
        directory=root / "batches",
        models=Models("llm=anthropic"),
        patience=Patience(tries=5, first=0.001, longest=0.01),
        poll=0.01,
    )


def stored(root: Path) -> list[str]:
    """List the questions whose answers are stored, each entry checked."""
    entries = Store(root, "completions").entries()
    return sorted(str(value_at(entry.request, ("messages", -1, "content"))) for entry in entries)


def texts(llm: HostedLLM, *asked: str) -> list[str]:
    """Ask, and return the answers in the order of the requests."""
    answers = dict(llm.complete([request(text) for text in asked]))
    return [answers[position].text for position in range(len(asked))]
