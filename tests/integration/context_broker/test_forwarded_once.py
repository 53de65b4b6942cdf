"""A change that another broker on the same database overtakes is made again here, and passed on once."""

import re
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register

from .several import Brokers

pytestmark = pytest.mark.slow

WRITERS, CHANGES = 4, 15


@pytest.fixture
def two(tmp_path_factory: pytest.TempPathFactory, new_database: Callable[[], str]) -> Iterator[Brokers]:
    """Two brokers on one database."""
    made = Brokers(tmp_path_factory.mktemp("two"), new_database())
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(made.started, (0, 1)))
    yield made
    made.stop()


def test_a_change_that_was_overtaken_is_passed_on_once(
    two: Brokers, source: ScriptedSource, kind: str, eventually: Callable[..., Any]
) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    at = f"/ngsi-ld/v1/entities/{one}"
    source.answers["PATCH", f"{at}/attrs"] = 204, None
    source.answers["POST", "/ngsi-ld/v1/entityOperations/update"] = 204, None
    with ExitStack() as stack:
        first, second = (stack.enter_context(two[number].client()) for number in range(2))
        put(first, one, kind, n=0)
        register(first, source.url, {"type": kind}, operations=["redirectionOps", "updateBatch"])
        eventually(lambda: len(second.get("/csourceRegistrations", params={"type": kind}).json()) == 1)

        def write(number: int) -> list[int]:
            statuses = []
            with two[number % 2].client() as client:
                for change in range(CHANGES):
                    said = number * CHANGES + change
                    if change % 3:
                        answer = client.patch(f"/entities/{one}/attrs", json={"n": said})
                    else:
                        answer = _in_a_batch(client, {"id": one, "type": kind, "n": said})
                    statuses.append(answer.status_code)
            return statuses

        with ThreadPoolExecutor(WRITERS) as pool:
            statuses = [status for some in pool.map(write, range(WRITERS)) for status in some]
        assert statuses == [204] * WRITERS * CHANGES
        assert sum(two[number].metric("handover_broker_commits_overtaken_total") for number in range(2)) > 0
        passed_on = [asked[4] for asked in source.asked if asked[0] in {"PATCH", "POST"}]
        told = [(said[0] if isinstance(said, list) else said)["n"] for said in passed_on]
        assert sorted(told) == list(range(WRITERS * CHANGES))


def _in_a_batch(client: httpx.Client, entity: dict[str, Any]) -> httpx.Response:
    return client.post("/entityOperations/update", json=[entity])


@pytest.fixture
def forgetful() -> Iterator[tuple[str, list[str]]]:
    """A source that answers the first request of each connection, and takes the next without an answer."""
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


def test_a_change_that_may_have_been_done_is_not_sent_again_and_a_question_is(
    near: httpx.Client, forgetful: tuple[str, list[str]], kind: str
) -> None:
    url, asked = forgetful
    one = put(near, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    register(near, url, {"type": kind})
    for _ in range(2):
        assert "ngsild-warning" not in near.get(f"/entities/{one}").headers
    assert asked == ["GET"] * 3  # of the second, nobody knew what had become
    asked.clear()
    statuses = [near.patch(f"/entities/{one}/attrs", json={"n": n}).status_code for n in range(4)]
    assert asked == ["PATCH"] * 4
    assert set(statuses) <= {204, 207}
    assert near.get(f"/entities/{one}?local=true").json()["n"]["value"] == 3
