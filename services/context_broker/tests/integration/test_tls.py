"""Notifications over TLS: certificates are checked with the authorities of the system and of the setting."""

import json
import ssl
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

Eventually = Callable[..., Any]


class SafeSubscriber:
    """A subscriber over HTTPS."""

    def __init__(self, certificate: tuple[Path, Path]) -> None:
        self.received: list[Any] = []
        received = self.received

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                received.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: Any) -> None:
                pass  # a broker that does not trust us goes away in the middle

        self.server = Server(("127.0.0.1", 0), Handler)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)
        self.server.socket = context.wrap_socket(self.server.socket, server_side=True)
        self.url = f"https://127.0.0.1:{self.server.server_address[1]}/notify"
        threading.Thread(target=self.server.serve_forever, args=(0.02,), daemon=True).start()

    def stop(self) -> None:
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def safe_subscriber(certificate: tuple[Path, Path]) -> Iterator[SafeSubscriber]:
    made = SafeSubscriber(certificate)
    yield made
    made.stop()


@pytest.mark.nightly
def test_only_who_is_vouched_for_is_notified(
    own_broker: Any,
    certificate: tuple[Path, Path],
    safe_subscriber: SafeSubscriber,
    eventually: Eventually,
) -> None:
    own_broker.start()
    subscription = {
        "id": "urn:ngsi-ld:Subscription:demo:safe",
        "type": "Subscription",
        "entities": [{"type": "Safe"}],
        "notification": {"endpoint": {"uri": safe_subscriber.url}},
    }
    path = f"/subscriptions/{subscription['id']}"
    with own_broker.client() as http:
        assert http.post("/subscriptions", json=subscription).status_code == 201
        http.post("/entities", json={"id": "urn:ngsi-ld:Safe:demo:1", "type": "Safe", "a": 1})
        eventually(lambda: http.get(path).json()["notification"].get("status") == "failed")
        assert "certificate" in own_broker.log()
        assert safe_subscriber.received == []
        own_broker.stop()
        own_broker.extra = {
            **own_broker.extra,
            "HANDOVER_BROKER_NOTIFICATION_CA_FILE": str(certificate[0]),
        }
        own_broker.start()
        eventually(lambda: safe_subscriber.received)
        assert safe_subscriber.received[0]["data"][0]["id"] == "urn:ngsi-ld:Safe:demo:1"
