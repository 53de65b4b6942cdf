"""Forwarded requests whose result is unknown: writes are not repeated, queries are."""

import re
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress

import httpx
import pytest

from tests.kit.context_sources import put, register


@pytest.fixture
def forgetful() -> Iterator[tuple[str, list[str]]]:
    """A source that answers the first request of each connection, and does not answer the next one."""
    asked: list[str] = []
    server = socket.create_server(("127.0.0.1", 0))

    def request(connection: socket.socket) -> bool:
        head = b""
        while b"\r\n\r\n" not in head:
            if not (more := connection.recv(65536)):
                return False
            head += more
        length = re.search(rb"(?i)content-length: (\d+)", head)
        missing = (int(length[1]) if length else 0) - len(head.partition(b"\r\n\r\n")[2])
        while missing > 0:
            missing -= len(connection.recv(65536))
        asked.append(head.split(b" ", 1)[0].decode())
        return True

    def answer(connection: socket.socket) -> None:
        with connection, suppress(OSError):
            if request(connection):
                connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")
                request(connection)

    def serve() -> None:
        with suppress(OSError):
            while True:
                connection, _ = server.accept()
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    yield f"http://127.0.0.1:{server.getsockname()[1]}", asked
    server.close()


@pytest.mark.nightly
def test_a_write_with_unknown_result_is_not_repeated_but_a_query_is(
    near: httpx.Client, forgetful: tuple[str, list[str]], kind: str
) -> None:
    url, asked = forgetful
    one = put(near, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    register(near, url, {"type": kind})
    for _ in range(2):
        assert "ngsild-warning" not in near.get(f"/entities/{one}").headers
    assert asked == ["GET"] * 3  # the result of the second was unknown
    asked.clear()
    statuses = [near.patch(f"/entities/{one}/attrs", json={"n": n}).status_code for n in range(4)]
    assert asked == ["PATCH"] * 4
    assert set(statuses) <= {204, 207}
    assert near.get(f"/entities/{one}?local=true").json()["n"]["value"] == 3
