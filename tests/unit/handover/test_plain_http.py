"""Plain HTTP against a server that says, byte for byte, what a test wants."""

import asyncio
import gzip
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import httpx
import pytest

from handover.plain_http import IDLE_S, PlainHttp

Answer = Callable[[asyncio.StreamWriter, bytes], Awaitable[None]]
NO_CONTENT = b"HTTP/1.1 204 No Content\r\n\r\n"


class Server:
    """Counts connections, and keeps what was asked."""

    def __init__(self, answer: Answer) -> None:
        self.connections = 0
        self.asked: list[bytes] = []
        self.port = 0
        self._answer = answer

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        try:
            while True:
                head = await reader.readuntil(b"\r\n\r\n")
                length = int(head.lower().partition(b"content-length:")[2].partition(b"\r\n")[0] or 0)
                body = await reader.readexactly(length)
                self.asked.append(head + body)
                await self._answer(writer, body)
                await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()


@asynccontextmanager
async def serving(answer: Answer) -> AsyncIterator[tuple[Server, httpx.AsyncClient]]:
    served = Server(answer)
    server = await asyncio.start_server(served.serve, "127.0.0.1", 0)
    served.port = server.sockets[0].getsockname()[1]
    url = f"http://127.0.0.1:{served.port}"
    async with httpx.AsyncClient(transport=PlainHttp(), base_url=url, timeout=0.5) as client:
        yield served, client
    server.close()


def says(*parts: bytes) -> Answer:
    async def answer(writer: asyncio.StreamWriter, _: bytes) -> None:
        for part in parts:
            writer.write(part)
            await writer.drain()
            await asyncio.sleep(0)

    return answer


async def test_requests_one_after_the_other_share_a_connection() -> None:
    async with serving(says(NO_CONTENT)) as (server, client):
        for number in range(3):
            answer = await client.post("/a?b=c", content=b"%d" % number, headers={"X-Of": "glove"})
            assert (answer.status_code, answer.content) == (204, b"")
    assert server.connections == 1
    assert server.asked[2].startswith(b"POST /a?b=c HTTP/1.1\r\n")
    assert b"\r\nX-Of: glove\r\n" in server.asked[2]
    assert server.asked[2].endswith(b"\r\n\r\n2")


async def test_requests_at_once_have_connections_of_their_own() -> None:
    async with serving(says(NO_CONTENT)) as (server, client):
        answers = await asyncio.gather(*(client.get("/") for _ in range(5)))
        assert {answer.status_code for answer in answers} == {204}
    assert server.connections == 5


@pytest.mark.parametrize(
    "parts",
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nab", b"cde"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nab\r\n", b"3\r\ncde\r\n0\r\n\r\n"),
        (b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\nContent-Le", b"ngth: 5\r\n\r\nabcde"),
    ],
)
async def test_an_answer_is_read_however_it_is_sent(parts: tuple[bytes, ...]) -> None:
    async with serving(says(*parts)) as (server, client):
        for _ in range(2):
            answer = await client.get("/")
            assert (answer.status_code, answer.reason_phrase, answer.text) == (200, "OK", "abcde")
    assert server.connections == 1


async def test_a_packed_answer_is_unpacked() -> None:
    packed = gzip.compress(b"a" * 1000)
    head = b"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\nContent-Length: %d\r\n\r\n" % len(packed)
    async with serving(says(head + packed)) as (_, client):
        assert (await client.get("/")).text == "a" * 1000


async def test_an_answer_may_end_with_its_connection() -> None:
    async def answer(writer: asyncio.StreamWriter, _: bytes) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\n\r\nabcde")
        writer.close()

    async with serving(answer) as (server, client):
        for _ in range(2):
            assert (await client.get("/")).text == "abcde"
    assert server.connections == 2


async def test_a_connection_that_the_server_will_close_is_not_used_again() -> None:
    async with serving(says(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n")) as (server, client):
        for _ in range(2):
            assert (await client.get("/")).status_code == 204
    assert server.connections == 2


async def test_a_connection_that_was_idle_for_long_is_not_used_again(monkeypatch: pytest.MonkeyPatch) -> None:
    async with serving(says(NO_CONTENT)) as (server, client):
        await client.get("/")
        loop = asyncio.get_running_loop()
        now = loop.time
        monkeypatch.setattr(loop, "time", lambda: now() + IDLE_S)
        await client.get("/")
    assert server.connections == 2


async def test_a_server_that_ends_before_it_has_answered_is_told_of() -> None:
    async def answer(writer: asyncio.StreamWriter, _: bytes) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nab")
        writer.close()

    async with serving(answer) as (_, client):
        with pytest.raises(httpx.ReadError, match="closed before an answer came"):
            await client.get("/")


async def test_a_server_that_says_nothing_is_waited_for_so_long() -> None:
    async with serving(says()) as (server, client):
        with pytest.raises(httpx.ReadTimeout, match=r"nothing was answered within 0\.5 s"):
            await client.get("/")
        with pytest.raises(httpx.ReadTimeout):
            await client.get("/")
    assert server.connections == 2


async def test_a_server_that_goes_on_answering_is_waited_for_longer() -> None:
    async def answer(writer: asyncio.StreamWriter, _: bytes) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\n")
        for letter in b"abcd":
            await asyncio.sleep(0.15)  # all four together take longer than the client waits for one
            writer.write(bytes([letter]))

    async with serving(answer) as (_, client):
        assert (await client.get("/")).text == "abcd"


async def test_what_is_not_http_is_told_of() -> None:
    async with serving(says(b"SSH-2.0-OpenSSH\r\n\r\n")) as (_, client):
        with pytest.raises(httpx.RemoteProtocolError, match="is not HTTP"):
            await client.get("/")


async def test_nobody_there_is_told_of() -> None:
    server = await asyncio.start_server(lambda _, __: None, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    await server.wait_closed()
    async with httpx.AsyncClient(transport=PlainHttp()) as client:
        with pytest.raises(httpx.ConnectError, match=f"127.0.0.1:{port}"):
            await client.get(f"http://127.0.0.1:{port}/")


async def test_a_request_that_was_given_up_leaves_no_answer_to_the_next() -> None:
    first = asyncio.Event()

    async def answer(writer: asyncio.StreamWriter, body: bytes) -> None:
        if body == b"first":
            first.set()
        else:
            writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n%b" % (len(body), body))

    async with serving(answer) as (server, client):
        asking = asyncio.create_task(client.post("/", content=b"first"))
        await first.wait()
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        assert (await client.post("/", content=b"second")).text == "second"
    assert server.connections == 2
