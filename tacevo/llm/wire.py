"""The layer between an SDK and a server: limits of bodies, requests that are not sent yet, proxies, certificates."""

import contextlib
import errno
import ipaddress
import os
import ssl
from collections.abc import AsyncIterator, Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.request import getproxies, proxy_bypass

import httpx2

from tacevo.errors import ConfigError

#: Bytes of a body, decompressed: ten times the longest answers, and an entry of it still fits into a bundle.
MOST_BYTES = 4 * 2**20

#: Bytes of an event stream, which wraps each word of an answer into some hundred bytes of its own.
MOST_STREAMED = 16 * MOST_BYTES

#: The variables that tell where certificates, and the keys of connections, are read and written.
_CERTIFICATES = ("SSL_CERT_FILE", "SSL_CERT_DIR")


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
    """The progress of a request that is being sent."""

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
    is_stream = response.headers.get("content-type", "").startswith("text/event-stream")
    bound(response, MOST_STREAMED if is_stream else MOST_BYTES)


#: The functions that an SDK's HTTP client calls before it sends a request, and before it reads a body.
HOOKS = {"request": [_begin], "response": [_bound]}


def certificates() -> ssl.SSLContext:
    """Return the context of encrypted connections, which reads the certificates of all authorities.

    Raises:
        ConfigError: the environment names files or directories of certificates that cannot be read.
    """
    read = [name for name in _CERTIFICATES if os.environ.get(name)][:1]  # the first counts
    named = {name: os.environ[name] for name in (*read, "SSLKEYLOGFILE") if os.environ.get(name)}
    try:
        context = httpx2.create_ssl_context()
        directories = os.environ.get("SSL_CERT_DIR", "").split(os.pathsep)
        if "SSL_CERT_FILE" not in named and directories != [""] and not any(map(os.path.isdir, directories)):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))  # OpenSSL would go on without any
    except OSError as error:  # those of SSL, too
        raise ConfigError(
            f"{', '.join(named.values())} ({error.strerror or error})",
            place=", ".join(named) or "certificates",
            expected="certificates in PEM files that can be read",
            remedy="correct the path, or unset the variable",
        ) from None
    return context


def by_certificates(error: object) -> str:
    """Say which certificates were tried, where a server's own is not accepted."""
    if not isinstance(error, ssl.SSLCertVerificationError):
        return ""
    named = next((name for name in _CERTIFICATES if os.environ.get(name)), None)
    if named is None:
        return "; name the certificates of your network by SSL_CERT_FILE"
    return f", with the certificates that {named} names ({os.environ[named]})"


def check_proxies(context: ssl.SSLContext, connect: Callable[..., object]) -> None:
    """Check that the proxies that the environment names can be used, and that it names hosts without one as it can.

    `connect` is what will read these variables: the HTTP client of an SDK, made with `verify`.

    Raises:
        ConfigError: a proxy is none, or of a kind that needs a package; or a host in NO_PROXY is none.
    """
    proxies = getproxies()
    for scheme in ("http", "https", "all"):
        address = proxies.get(scheme, "")
        try:
            if address:
                proxy = address if "://" in address else f"http://{address}"
                httpx2.HTTPTransport(verify=context, proxy=proxy).close()
        except (ImportError, ValueError, httpx2.InvalidURL) as error:
            shown = "an address with a login that cannot be read" if "@" in address else f"{address} ({error})"
            raise ConfigError(
                shown,
                place=f"{scheme.upper()}_PROXY",
                expected="a proxy that can be used",
                remedy="correct or unset the variable, or name the server's host in NO_PROXY",
            ) from None
    try:
        connect(verify=context)
    except (ValueError, httpx2.InvalidURL) as error:
        hosts = [host.strip() for host in proxies.get("no", "").split(",")]
        odd = [host for host in hosts if not _is_host(host)]
        raise ConfigError(
            f"{', '.join(odd) or proxies.get('no', '')} ({error})",
            place="NO_PROXY",
            expected="names and addresses of hosts with commas between them",
            remedy="write an IPv6 address without brackets, as in NO_PROXY=localhost,::1, or leave the entry out",
        ) from None


def _is_host(name: str) -> bool:
    """Answer whether every HTTP client reads an entry of NO_PROXY: of `[::1]`, some do."""
    with contextlib.suppress(ValueError):
        return bool(ipaddress.ip_address(name))
    try:
        httpx2.URL(name if "://" in name else f"all://*{name}")
    except (ValueError, httpx2.InvalidURL):
        return False
    return True


def by_proxy(address: httpx2.URL) -> str:
    """Say that the environment puts a proxy before an address; its own may hold a password, and is not shown."""
    proxies = getproxies()
    named = next((name for name in (address.scheme, "all") if proxies.get(name)), None)
    if named is None or proxy_bypass(address.host):
        return ""
    return f", through the proxy that {named.upper()}_PROXY names"


#: The limit of a body for a client of batches, whose results are one body.
bound_results = partial(bound, most=2**30)
