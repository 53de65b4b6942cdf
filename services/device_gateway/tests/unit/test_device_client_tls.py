"""The client reads and writes with TLS in several threads; OpenSSL forbids both at the same moment."""

import json
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from handover_devices.device_client import DeviceClient, tls_context
from tests.kit.certificates import Certificates
from tests.kit.waiting import scaled, wait_for

MESSAGES = 300
COMMANDS = 300


class WatchedSocket(ssl.SSLSocket):
    """Notes when a thread enters the connection while another one is inside."""

    inside = 0
    overlaps = 0
    guard = threading.Lock()

    @contextmanager
    def _entered(self) -> Iterator[None]:
        cls = WatchedSocket
        with cls.guard:
            cls.inside += 1
            cls.overlaps += cls.inside > 1
        try:
            yield
        finally:
            with cls.guard:
                cls.inside -= 1

    def read(self, *args: Any) -> Any:
        with self._entered():
            return super().read(*args)

    def send(self, data: Any, flags: int = 0) -> int:
        with self._entered():
            return super().send(data, flags)


def serve(server: socket.socket, tls: ssl.SSLContext, received: list[int]) -> None:
    """Accept a device, send it commands, and acknowledge what it sends."""
    clear, _ = server.accept()
    with tls.wrap_socket(clear, server_side=True) as connection:
        lines = connection.makefile("rb")
        lines.readline()
        connection.sendall(b'{"type":"ack"}\n')
        for number in range(COMMANDS):
            command = {"type": "command", "id": f"c-{number}", "name": "none", "parameters": {"x": "y" * 500}}
            connection.sendall(json.dumps(command).encode() + b"\n")
        for line in lines:
            message = json.loads(line)
            if "seq" in message:
                received.append(message["seq"])
                connection.sendall(json.dumps({"type": "ack", "seq": message["seq"]}).encode() + b"\n")


def test_no_two_threads_use_the_tls_connection_at_once(tmp_path: Path) -> None:
    files = Certificates(tmp_path).make("localhost")
    serving = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    serving.load_cert_chain(files.certificate, files.key)
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(scaled(30))
    received: list[int] = []
    threading.Thread(target=serve, args=(server, serving, received), daemon=True).start()
    context = tls_context(str(files.authority))
    context.sslsocket_class = WatchedSocket
    client = DeviceClient("localhost", server.getsockname()[1], "hall-1", "secret", tls=context)
    client.start()

    def send() -> None:
        for number in range(MESSAGES):
            client.send({"temperature": number}, t=float(number))

    senders = [threading.Thread(target=send) for _ in range(3)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join()
    wait_for(lambda: client.waiting() == 0)
    client.stop()
    server.close()
    assert sorted(set(received)) == list(range(1, 3 * MESSAGES + 1))
    assert WatchedSocket.overlaps == 0
