"""What passes between an SDK and a server: bodies up to a limit, and which requests are not sent yet."""

from collections.abc import AsyncIterator, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.request import getproxies, proxy_bypass

import httpx2

from tacevo.errors import ConfigError

#: Bytes of a body, decompressed: ten times the longest answers, and an entry of it still fits into a bundle.
MOST_BYTES = 4 * 2**20


class _Bounded(httpx2.AsyncByteStream, httpx2.SyncByteStream):
    """The body of a response, decompressed piece by piece, up to a limit in bytes."""

    def __init__(self, response: httpx2.Response, most: int) -> None:
        self._coded = httpx2.Response(response.status_code, headers=response.headers, stream=response.stream)
        self._left = self._most = most

    def _checked(self, part: bytes) -> bytes:
        self._left -= len(part)
        if self._left < 0:
            raise httpx2.DecodingError(f"the body is larger than {self._most / 2**20:g} MiB")
        return part

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for part in self._coded.aiter_bytes():
            yield self._checked(part)

    def __iter__(self) -> Iterator[bytes]:
        for part in self._coded.iter_bytes():
            yield self._checked(part)

    async def aclose(self) -> None:
        await self._coded.aclose()

    def close(self) -> None:
        self._coded.close()


def bound(response: httpx2.Response, most: int = MOST_BYTES) -> None:
    """Let a response have so many bytes, decompressed; more is an error of the connection."""
    response.stream = _Bounded(response, most)
    response.headers.pop("content-encoding", None)


@dataclass(slots=True)
class Sending:
    """How far a request is."""

    #: Whether nothing of it is sent yet, because the connection does not stand.
    waits: bool = False


#: The request of the task that asks.
SENDING: ContextVar[Sending] = ContextVar("SENDING")


async def _begin(request: httpx2.Request) -> None:
    """Let a request say when it is sent: headers that ask a proxy for a connection are not yet its own."""
    sending = SENDING.get(Sending())
    sending.waits = True

    async def follow(event: str, about: dict[str, Any]) -> None:
        if event.endswith("send_request_headers.started") and about["request"].method != b"CONNECT":
            sending.waits = False

    request.extensions["trace"] = follow


async def _bound(response: httpx2.Response) -> None:
    bound(response)


#: What the HTTP client of an SDK calls before it sends a request, and before it reads a body.
HOOKS = {"request": [_begin], "response": [_bound]}


def check_proxies(context: Any) -> None:
    """Check, with an SSL context, that the proxies that the environment names can be used.

    Raises:
        ConfigError: a name is none, or of a kind that needs a package.
    """
    try:
        httpx2.Client(verify=context).close()
    except (ImportError, ValueError, httpx2.InvalidURL) as error:
        remedy = "unset the variable, or name the server's host in NO_PROXY"
        place = "HTTP_PROXY, HTTPS_PROXY, ALL_PROXY"
        raise ConfigError(str(error), place=place, expected="proxies that can be used", remedy=remedy) from None


def by_proxy(address: httpx2.URL) -> str:
    """Say that the environment puts a proxy before an address; its own may hold a password, and is not shown."""
    proxies = getproxies()
    named = next((name for name in (address.scheme, "all") if proxies.get(name)), None)
    if named is None or proxy_bypass(address.host):
        return ""
    return f", through the proxy that {named.upper()}_PROXY names"


#: For a client of batches, whose results are one body.
bound_results = partial(bound, most=2**30)
