"""Connections for very many requests at once.

A client of the SDKs looks through all its connections at every request, so a thousand in one pool are slow and ten
thousand stand still. Many requests are therefore dealt out to several clients.
"""

from collections.abc import Iterator
from typing import Any

import httpx2

#: Requests of one client at once, about.
SHARE = 100


def shares(concurrency: int, timeout: httpx2.Timeout) -> Iterator[dict[str, Any]]:
    """Give the arguments of as many HTTP clients as so many requests at once need.

    Args:
        concurrency: requests at once; whoever asks keeps to it, so that no client has to hold any back.
        timeout: of every request.
    """
    context = httpx2.create_ssl_context()  # one for all: it holds every certificate authority
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=min(concurrency, 2 * SHARE))
    for _ in range(-(-concurrency // SHARE)):
        yield {"limits": limits, "timeout": timeout, "verify": context}
