"""Ends of responses to notifications: a received 2xx status is a delivery."""

import subprocess
import sys
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx
import psutil
import pytest

from services.context_broker.tests.integration.acts import create, patch, subscribe
from services.context_broker.tests.integration.conftest import BrokerProcess, wait_for
from tests.kit.rubbish_source import RubbishSource

SERVER = """
import sys
from http.server import BaseHTTPRequestHandler, HTTPServer
class Handler(BaseHTTPRequestHandler):
    def do_POST(self):
        print(self.rfile.read(int(self.headers["Content-Length"])).decode(), flush=True)
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"thank you" * int(sys.argv[1]))
    def log_message(self, *_):
        pass
server = HTTPServer(("127.0.0.1", 0), Handler)
print(server.server_address[1], flush=True)
server.serve_forever()
"""
"""Python's own server as its documentation shows it: HTTP/1.0, no Content-Length."""

DELIVERED: dict[str, tuple[tuple[bytes, ...], bool]] = {
    "HTTP/1.0": ((b"HTTP/1.0 200 OK\r\n\r\n",), True),
    "HTTP/1.0 with a body": ((b"HTTP/1.0 200 OK\r\n\r\n", b"thank you"), True),
    "Connection: close": ((b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\nthank", b" you"), True),
    "no framing at all": ((b"HTTP/1.1 202 Accepted\r\n\r\n",), True),
    "no framing, left open": ((b"HTTP/1.1 200 OK\r\n\r\n",), False),
    "a body that is cut": ((b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nthank",), True),
    "a body that never comes": ((b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n",), False),
    "chunks that are cut": ((b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\ntha",), True),
    "chunks that are none": ((b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"ZZ\r\n"), True),
    "an interim answer first": ((b"HTTP/1.1 103 Early Hints\r\n\r\n", b"HTTP/1.0 200 OK\r\n\r\n"), True),
    "a body beyond the limit": ((b"HTTP/1.1 200 OK\r\n\r\n", *[b"x" * 65_536] * 8), True),
}
FAILED: dict[str, tuple[bytes, ...]] = {
    "nothing": (),
    "half a head": (b"HTTP/1.1 200 OK\r\nContent-Len",),
    "an interim answer alone": (b"HTTP/1.1 100 Continue\r\n\r\n",),
    "503 that ends with the connection": (b"HTTP/1.0 503 Busy\r\n\r\nlater",),
}


@pytest.fixture
def receiver() -> Iterator[RubbishSource]:
    """A receiver that answers given bytes."""
    made = RubbishSource()
    yield made
    made.stop()


@pytest.mark.nightly
@pytest.mark.parametrize("times", [0, 1, 100_000], ids=["no body", "a body", "a long body"])
def test_the_server_of_pythons_library_gets_each_notification_once(
    http: httpx.Client, kind: str, times: int
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", SERVER, str(times)], stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            assert server.stdout is not None
            url = f"http://127.0.0.1:{server.stdout.readline().strip()}/notify"
            subscription = subscribe(http, kind, url)
            entity = create(http, kind, n=0)
            for number in range(1, 5):
                patch(http, entity, n=number)
            received = [server.stdout.readline() for _ in range(5)]
            assert [f'"value":{number}' in one for number, one in enumerate(received)] == [True] * 5
            counted = wait_for(lambda: _counts(http, subscription, 5))
            assert (counted.get("timesFailed", 0), counted["status"]) == (0, "ok")
        finally:
            server.kill()


@pytest.mark.nightly
@pytest.mark.parametrize("ending", DELIVERED)
def test_a_2xx_head_is_a_delivery_however_the_answer_ends(
    http: httpx.Client, shared_broker: BrokerProcess, receiver: RubbishSource, kind: str, ending: str
) -> None:
    pieces, closes = DELIVERED[ending]
    receiver.says(*pieces, pause_s=0.05, closes=closes)
    subscription = subscribe(http, kind, receiver.url)
    entity = create(http, kind, n=0)
    patch(http, entity, n=1)
    patch(http, entity, n=2)
    counted = wait_for(lambda: _counts(http, subscription, 3))
    assert (counted.get("timesFailed", 0), counted["status"]) == (0, "ok")
    assert shared_broker.process is not None
    broker, port = psutil.Process(shared_broker.process.pid), urlsplit(receiver.url).port
    wait_for(
        lambda: not any(one.raddr[1:] == (port,) for one in broker.net_connections()),
        why="the broker keeps a connection that is of no use",
    )


@pytest.mark.parametrize("ending", FAILED)
def test_a_response_without_a_2xx_head_is_a_failure(
    http: httpx.Client, receiver: RubbishSource, kind: str, ending: str
) -> None:
    receiver.says(*FAILED[ending])
    subscription = subscribe(http, kind, receiver.url)
    create(http, kind, n=0)
    path = f"/subscriptions/{subscription}"
    wait_for(lambda: http.get(path).json()["notification"].get("timesFailed", 0) >= 1)
    assert "lastSuccess" not in http.get(path).json()["notification"]


def _counts(http: httpx.Client, subscription: str, sent: int) -> dict[str, object] | None:
    """Return the counters of a subscription once it has `sent` notifications, the last with success."""
    counted = http.get(f"/subscriptions/{subscription}").json()["notification"]
    if counted.get("timesSent", 0) < sent or counted.get("lastNotification") != counted.get("lastSuccess"):
        time.sleep(0.05)
        return None
    return dict(counted)
