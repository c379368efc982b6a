"""Promise: a server that is not there is named with the cause and soon given up; no body fills the memory.

The real SDKs meet what listens on this machine; each rule holds for both.
"""

import gc
import gzip
import os
import re
import signal
import socket
import ssl
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import pytest
from asked import request
from hosted import PROVIDERS, QUICK, batched, hosted, texts
from llm_server import listen, serving
from raw_server import CUT, Reply, replying
from refusals import refused

from tacevo.errors import ConfigError, TransportError
from tacevo.llm import anthropic
from tacevo.llm.recording import RecordingLLM
from tacevo.llm.retry import Fault, FaultKind, Patience
from tacevo.llm.wire import MOST_BYTES, bound, by_certificates, certificates
from tacevo.storage.store import Store

pytestmark = pytest.mark.usefixtures("keys", "direct")
both = pytest.mark.parametrize("provider", PROVIDERS)

#: Ten tries, as usual, without their waits.
PATIENT = Patience(first=0.001, longest=0.01)

PROXIES = [name for word in ("HTTP", "HTTPS", "ALL", "NO") for name in (f"{word}_PROXY", f"{word}_proxy".lower())]


@pytest.fixture
def direct(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin without a proxy."""
    for name in PROXIES:
        monkeypatch.delenv(name, raising=False)


@both
@pytest.mark.parametrize(
    ("address", "cause"),
    [
        ("http://127.0.0.1:1", "Connection refused"),
        ("http://localhost:1", "Connection refused"),
        ("http://no-such-host.invalid", "not known|resolution|hostname"),
    ],
)
def test_server_that_is_not_there_is_named_with_the_cause(
    address: str, cause: str, provider: str, caplog: pytest.LogCaptureFixture
) -> None:
    """In one line, after a few tries, where ten would be made if it ever had answered."""
    remedy = "start the server, or check llm.base_url"
    with refused(TransportError, got="2 of 2 requests failed after all tries", remedy=remedy) as caught:
        texts(hosted(address, provider, patience=PATIENT), "a", "b")
    assert re.search(rf"no connection to {address}: .*({cause})", caught.value.got)
    assert "\n" not in caught.value.got
    assert caplog.text.count("asking again") == 1


def test_tries_are_few_only_where_no_answer_ever_came() -> None:
    """An outage later is waited for, and so is a server that is there and busy."""
    silent = Fault(kind=FaultKind.passing, message="no connection", silent=True)
    tried = {
        (heard, fault.silent): sum(
            PATIENT.wait(tries, fault, jitter=0, heard=heard) is not None for tries in range(1, 20)
        )
        for heard in (False, True)
        for fault in (silent, Fault(kind=FaultKind.passing, message="529: busy"))
    }
    assert tried == {(False, True): 3, (False, False): 9, (True, True): 9, (True, False): 9}


@both
def test_refusal_is_an_answer_of_the_server(provider: str) -> None:
    """A server that was busy at the first request and then cuts its connection is there: all tries are made."""

    def reply(body: object, number: int) -> Reply:
        return 429 if number < 3 else CUT, {"error": {"message": "slow down"}}

    with replying(reply) as server:
        with refused(TransportError, got="1 of 1 requests failed after all tries"):
            texts(hosted(server.url, provider, patience=PATIENT), "a")
        assert len(server.bodies) == PATIENT.tries


@both
def test_later_outage_is_waited_for(provider: str) -> None:
    """The server goes away after its first answer, and comes back at the seventh try."""
    with serving() as server:
        llm = hosted(server.url, provider, patience=Patience(first=0.05, longest=0.05))
        assert texts(llm, "a") == ["a!"]
        port = int(server.url.rpartition(":")[2])
    back = threading.Event()

    def come_back() -> None:
        with serving(listening=listen(port)):
            back.wait(60)

    thread = threading.Timer(0.3, come_back)
    thread.start()
    try:
        assert texts(llm, "b") == ["b!"]
    finally:
        back.set()
        thread.join()


@both
def test_server_that_says_nothing_is_named_and_given_up(provider: str) -> None:
    """Something else listens there, and ends each connection; the request was sent, so it may be billed."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=speak_plainly, args=(listening, 4, b""), daemon=True).start()
        address = f"http://127.0.0.1:{listening.getsockname()[1]}"
        with refused(TransportError, got=f"{address}: ", remedy="start the server, or check llm.base_url") as caught:
            texts(hosted(address, provider, patience=PATIENT), "a")
    assert "no connection" not in caught.value.got


@both
def test_server_without_encryption_is_told(provider: str) -> None:
    """An address that begins with https where the server speaks plain HTTP."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=speak_plainly, args=(listening, QUICK.tries), daemon=True).start()
        address = f"https://127.0.0.1:{listening.getsockname()[1]}"
        with refused(TransportError, got=f"no connection to {address}: ") as caught:
            texts(hosted(address, provider, patience=QUICK), "a")
    assert "SSL" in caught.value.got


PLAIN = b"HTTP/1.1 400 Bad Request\r\n\r\n"


def speak_plainly(listening: socket.socket, times: int, words: bytes = PLAIN) -> None:
    """Answer whatever comes with the same words, so many times."""
    for _ in range(times):
        connection, _ = listening.accept()
        with connection:
            connection.recv(4096)
            connection.sendall(words)


@both
def test_proxy_is_named_and_its_password_is_not(provider: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be reached may be the proxy, which a user may not know of."""
    monkeypatch.setenv("HTTP_PROXY", "http://me:hunter2@127.0.0.1:1")
    with refused(TransportError, got="through the proxy that HTTP_PROXY names: Connection refused") as caught:
        texts(hosted("http://model.example", provider, patience=QUICK), "a")
    assert "hunter2" not in str(caught.value)


@pytest.mark.parametrize("proxy", ["foo://me:hunter2@127.0.0.1:1", "http://[::1"])
@pytest.mark.parametrize("connect", [*(connect for connect, _ in PROVIDERS.values())])
def test_unusable_proxy_is_refused_before_anything_is_asked(
    connect: object, proxy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the environment's fault, which the message names."""
    monkeypatch.setenv("ALL_PROXY", proxy)
    assert callable(connect)
    with refused(ConfigError, place="ALL_PROXY", remedy="NO_PROXY") as caught:
        connect("http://model.example", 1)
    assert "hunter2" not in str(caught.value)


@pytest.fixture
def silent() -> Iterator[str]:
    """Return the https address of a socket that nobody serves: connections stand, and no handshake ends."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield f"https://127.0.0.1:{listening.getsockname()[1]}"


@both
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # httpcore leaves its socket to be freed
def test_interruption_waits_for_nothing_that_was_not_sent(
    provider: str, silent: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """No answer is in flight, so none is paid for, and the command ends at once."""
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        list(RecordingLLM(hosted(silent, provider), Store(tmp_path, "completions")).complete([request("a")]))
    gc.collect()
    assert "in flight" not in caplog.text


@both
def test_interruption_waits_for_what_was_sent(provider: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The command says what it waits for; the answer that was paid for is stored before it ends."""
    store = Store(tmp_path, "completions")
    with serving() as server:
        server.held = {"a": threading.Event()}
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        threading.Timer(1.0, server.held["a"].set).start()
        with pytest.raises(KeyboardInterrupt):
            list(RecordingLLM(hosted(server.url, provider), store).complete([request("a")]))
    assert "in flight, because they are paid for" in caplog.text
    assert len(list(store.entries())) == 1


def test_batch_that_never_left_is_not_said_to_be_billed(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Nobody has it; and the first command about it is soon given up, too."""
    with refused(TransportError, got="no connection to http://127.0.0.1:1: Connection refused"):
        list(batched("http://127.0.0.1:1", tmp_path).complete([request("a")]))
    assert "billed" not in caplog.text


def bombs() -> dict[str, tuple[bytes, str]]:
    """Make bodies that are too large, as they are and compressed, with their content encodings."""
    large = b'{"choices": [{"message": {"content": "%s"}}]}' % (b"a" * (MOST_BYTES + 1))
    zipped = gzip.compress(large)
    return {
        "as it is": (large, "identity"),
        "gzip": (zipped, "gzip"),
        "deflate": (zlib.compress(large), "deflate"),
        "gzip twice": (gzip.compress(zipped), "gzip, gzip"),
    }


BOMBS = bombs()


@both
@pytest.mark.parametrize(("bomb", "status"), [*((name, 200) for name in BOMBS), ("gzip", 500)])
def test_body_that_is_too_large_is_refused(bomb: str, status: int, provider: str) -> None:
    """Whatever it is sent as, and also where it explains an error."""
    data, coding = BOMBS[bomb]
    with replying((status, data), {"content-encoding": coding}) as server:
        with refused(TransportError, got="the body is larger than 4 MiB"):
            texts(hosted(server.url, provider, patience=QUICK), "a")
        assert len(server.bodies) == 3


@both
def test_compressed_answer_is_read(provider: str) -> None:
    """A limit is no reason to lose an answer that was compressed."""
    content = [{"type": "text", "text": "hi"}]
    body = {"content": content, "stop_reason": "end_turn", "choices": [{"message": {"content": "hi"}}]}
    data = gzip.compress(repr(body).replace("'", '"').encode())
    with replying((200, data), {"content-encoding": "gzip"}) as server:
        assert texts(hosted(server.url, provider, patience=QUICK), "a") == ["hi"]
        assert len(server.bodies) == 1


def test_results_of_a_batch_are_one_body_with_a_limit() -> None:
    """It counts decompressed bytes, so a few thousand that unpack to more are refused before they are unpacked."""
    packed = gzip.compress(b"a" * 2**20)
    response = httpx2.Response(200, headers={"content-encoding": "gzip"}, stream=httpx2.ByteStream(packed))
    bound(response, most=2**16)
    with pytest.raises(httpx2.DecodingError, match=r"larger than 0\.0625 MiB"):
        response.read()


CONNECTS = [*(connect for connect, _ in PROVIDERS.values()), lambda url, _: anthropic.connect_batches(url)]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("NO_PROXY", "localhost,[::1]"),
        ("NO_PROXY", "[::1]:8000,localhost"),
        ("NO_PROXY", "localhost,http://[::1"),
        ("NO_PROXY", "a:b:c"),
        ("NO_PROXY", "localhost,fe80::/10"),
        ("HTTP_PROXY", "http://proxy:port"),
        ("HTTPS_PROXY", ":::"),
        ("HTTPS_PROXY", "http://me:hunter2@[::1"),
        ("ALL_PROXY", "socks5://localhost:1"),
        ("SSL_CERT_FILE", "/nowhere/cacert.pem"),
        ("SSL_CERT_FILE", __file__),
        ("SSL_CERT_DIR", "/nowhere/certificates"),
        ("SSL_CERT_DIR", "/nowhere/one:/nowhere/two"),
    ],
)
@pytest.mark.parametrize("connect", CONNECTS)
def test_variable_that_cannot_be_used_is_named_with_its_value(
    connect: Callable[[str | None, int], object], name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It works, as some clients read `[::1]`, or the variable is blamed: not the address, and not the key."""
    for other in ("SSL_CERT_FILE", "SSL_CERT_DIR"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(name, value)
    if connect is CONNECTS[1] and name == "NO_PROXY":  # its client leaves out what it cannot read
        connect("http://127.0.0.1:1", 1)
        return
    with refused(ConfigError, place=name) as caught:
        connect("http://127.0.0.1:1", 1)
    shown = [value, *value.split(","), "a login that cannot be read", "socks"]
    assert any(part in caught.value.got for part in shown)
    assert "hunter2" not in str(caught.value)
    assert "key" not in caught.value.remedy


@pytest.mark.parametrize(
    "hosts", ["localhost,127.0.0.1,::1", "*", "example.com,.example.org", "10.0.0.0/8, fe80::1", ""]
)
@pytest.mark.parametrize("connect", CONNECTS)
def test_hosts_without_a_proxy_are_read(
    connect: Callable[[str | None, int], object], hosts: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names, networks and addresses as people write them; also beside a proxy."""
    monkeypatch.setenv("NO_PROXY", hosts)
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:1")
    connect("http://127.0.0.1:1", 1)


def test_directories_of_certificates_may_be_several(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As OpenSSL reads them, of which one that is there is enough."""
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    monkeypatch.setenv("SSL_CERT_DIR", f"/nowhere/one{os.pathsep}{tmp_path}")
    certificates()


def test_certificates_that_are_not_accepted_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of a handshake says nothing of the variable that is at fault."""
    refusal = ssl.SSLCertVerificationError("unable to get local issuer certificate")
    monkeypatch.delenv("SSL_CERT_FILE", raising=False)
    monkeypatch.delenv("SSL_CERT_DIR", raising=False)
    assert "by SSL_CERT_FILE" in by_certificates(refusal)
    monkeypatch.setenv("SSL_CERT_FILE", "/some/cacert.pem")
    assert "SSL_CERT_FILE" in by_certificates(refusal)
    assert "/some/cacert.pem" in by_certificates(refusal)
    assert by_certificates(OSError("refused")) == ""
