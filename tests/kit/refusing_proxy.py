"""A proxy before a broker, which refuses what a test names, and records what the broker has accepted.

With a `token` it is a policy enforcement point: without that token it answers 401.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx

_HOP_BY_HOP = frozenset({"connection", "transfer-encoding", "content-length", "content-encoding", "date"})


@dataclass
class RefusingProxy:
    """What the proxy does: it answers `status` to requests that have one of the texts in `refused`.

    They are sought in "METHOD PATH", followed by the body.
    """

    target: str
    url: str = ""
    refused: frozenset[bytes] = frozenset()
    status: int = 503
    token: str | None = None
    refusals: int = 0
    ahead_s: float = 0.0
    """How far the clock of the broker is ahead, by the header Date."""
    tokens: set[str] = field(default_factory=set)
    """What was received as Authorization."""
    accepted: list[tuple[str, bytes]] = field(default_factory=list)
    """Path and body of the accepted writes, in their order."""


@contextmanager
def refusing_proxy(target: str) -> Iterator[RefusingProxy]:
    """Run a proxy before the server at `target`."""
    proxy = RefusingProxy(target)
    client = httpx.Client(base_url=target, trust_env=False, timeout=120)

    class Handler(BaseHTTPRequestHandler):
        def forward(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
            given = self.headers.get("Authorization")
            if given is not None:
                proxy.tokens.add(given)
            if proxy.token is not None and given != f"Bearer {proxy.token}":
                self.answer(401, {}, b'{"title": "Unauthorized", "detail": "no valid token"}')
                return
            request = f"{self.command} {self.path}".encode() + body
            if any(text in request for text in proxy.refused):
                proxy.refusals += 1
                self.answer(proxy.status, {}, b'{"title": "Refused", "detail": "as the test wants"}')
                return
            headers = {name: value for name, value in self.headers.items() if name.lower() != "host"}
            try:
                answer = client.request(self.command, self.path, content=body, headers=headers)
            except httpx.TransportError:
                self.answer(503, {}, b'{"title": "Not there"}')
                return
            if self.command == "POST" and answer.is_success:
                proxy.accepted.append((self.path, body))
            kept = {name: value for name, value in answer.headers.items() if name not in _HOP_BY_HOP}
            self.answer(answer.status_code, kept, answer.content)

        def date_time_string(self, timestamp: float | None = None) -> str:
            return super().date_time_string((timestamp or time.time()) + proxy.ahead_s)

        def answer(self, status: int, headers: dict[str, str], body: bytes) -> None:
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_POST = do_PATCH = do_DELETE = forward  # noqa: N815 - as the base class calls them

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    proxy.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield proxy
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
        client.close()
