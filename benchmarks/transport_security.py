"""The cost of TLS: processor time of a server per request and per connection, with TLS and without.

    python -m benchmarks.transport_security [--requests 4000] [--connections 400] [--rounds 3]

One service process answers `GET /healthz`. Requests are sent on one connection that stays open; connections
are made one after the other, each with one request and a full handshake (no resumption). Prints the median of
the rounds.
"""

import argparse
import contextlib
import os
import socket
import ssl
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

from handover.transport_security.local_authority import LocalAuthority, ServerFiles

REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
BODY_END = b"}"


@contextlib.contextmanager
def service(folder: Path, files: ServerFiles | None) -> Iterator[tuple[int, psutil.Process]]:
    """Run the study service, with TLS if there are files; yield its port and process."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = int(probe.getsockname()[1])
    environment = {**os.environ, "HANDOVER_DATA_DIR": str(folder), "HANDOVER_STUDY_PORT": str(port)}
    if files is not None:
        environment |= {
            "HANDOVER_TLS_CERTIFICATE": str(files.certificate),
            "HANDOVER_TLS_KEY": str(files.key),
            "HANDOVER_TLS_AUTHORITY": str(files.authority),
        }
    command = [sys.executable, "-m", "handover_study"]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as process:
        try:
            while True:
                with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
                    break
                time.sleep(0.1)
            yield port, psutil.Process(process.pid)
        finally:
            process.terminate()


def connect(port: int, context: ssl.SSLContext | None) -> socket.socket:
    """Return a connection, with a full handshake if there is a context."""
    plain = socket.create_connection(("127.0.0.1", port))
    plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return plain if context is None else context.wrap_socket(plain, server_hostname="localhost")


def ask(connection: socket.socket) -> None:
    """Send a request and read the response."""
    connection.sendall(REQUEST)
    received = b""
    while not received.endswith(BODY_END):
        received += connection.recv(65536)


def measure(
    port: int, server: psutil.Process, context: ssl.SSLContext | None, asked: int, made: int
) -> tuple[float, ...]:
    """Return processor and wall time in microseconds, per request and per connection."""

    def spent_s() -> tuple[float, float]:
        times = server.cpu_times()
        return times.user + times.system, time.perf_counter()

    with connect(port, context) as connection:
        ask(connection)
        before = spent_s()
        for _ in range(asked):
            ask(connection)
        between = spent_s()
    for _ in range(made):
        with connect(port, context) as connection:
            ask(connection)
    after = spent_s()
    per_request = [(b - a) / asked * 1e6 for a, b in zip(before, between, strict=True)]
    per_connection = [(b - a) / made * 1e6 for a, b in zip(between, after, strict=True)]
    return (*per_request, *per_connection)


def main() -> None:
    """Measure both and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--requests", type=int, default=4000)
    parser.add_argument("--connections", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    print("microseconds      request: server CPU   wall   connection and request: server CPU   wall")
    with tempfile.TemporaryDirectory() as folder:
        files = LocalAuthority(Path(folder) / "tls").secure(Path(folder) / "server", [])
        for name, chosen in (("plain", None), ("TLS 1.3", files)):
            context = None if chosen is None else ssl.create_default_context(cafile=chosen.authority)
            with service(Path(folder) / name, chosen) as (port, server):
                rounds = [
                    measure(port, server, context, given.requests, given.connections)
                    for _ in range(given.rounds)
                ]
            row = [statistics.median(column) for column in zip(*rounds, strict=True)]
            print(f"{name:<10} {row[0]:26.0f} {row[1]:7.0f} {row[2]:33.0f} {row[3]:7.0f}")


if __name__ == "__main__":
    main()
