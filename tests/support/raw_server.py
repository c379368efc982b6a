"""A server that answers with whatever statuses and bytes it is told, for what no sound server sends."""

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

#: What a request gets: a status, and a body as JSON or as bytes.
Reply = tuple[int, Any]

#: The status of a connection that is cut instead.
CUT = 0


class RawServer(ThreadingHTTPServer):
    """Notes the bodies that it is sent, and replies to each by its number, from 0."""

    daemon_threads = True

    def __init__(self, reply: Callable[[dict[str, Any], int], Reply], headers: dict[str, str]) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.reply = reply
        self.headers = headers
        self.bodies: list[dict[str, Any]] = []
        self.url = f"http://127.0.0.1:{self.server_address[1]}"


class _Handler(BaseHTTPRequestHandler):
    server: RawServer
    protocol_version = "HTTP/1.1"

    def do_POST(self) -> None:
        """Reply to one request."""
        body = json.loads(self.rfile.read(int(self.headers["content-length"])))
        number = len(self.server.bodies)
        self.server.bodies.append(body)
        status, said = self.server.reply(body, number)
        if status == CUT:
            self.close_connection = True
            return
        data = said if isinstance(said, bytes) else json.dumps(said).encode()
        self.send_response(status)
        for name, value in {"content-type": "application/json", **self.server.headers}.items():
            self.send_header(name, value)
        self.send_header("content-length", str(len(data)))
        self.end_headers()
        with contextlib.suppress(ConnectionError):
            self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


@contextlib.contextmanager
def replying(
    reply: Callable[[dict[str, Any], int], Reply] | Reply, headers: dict[str, str] | None = None
) -> Iterator[RawServer]:
    """Run such a server; one reply is that to all requests."""
    server = RawServer(reply if callable(reply) else lambda body, number: reply, headers or {})
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
