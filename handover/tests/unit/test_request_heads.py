"""Heads of requests: however their bytes come, the same requests are answered and the same are refused."""

import asyncio
import re
from collections.abc import Iterable, Sequence
from typing import Any

import pytest
import uvicorn
from hypothesis import given
from hypothesis import strategies as st
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send
from uvicorn.server import ServerState

from handover.http.protocol import (
    MAX_HEAD_BYTES,
    MAX_HEAD_LINES,
    MAX_PIPELINED,
    Connections,
    HttpProtocol,
)
from handover.settings import Settings

SETTINGS = Settings.load(_env_file=None)
RESPONSE = re.compile(rb"HTTP/1\.1 (\d{3}) ")


class Sent(bytes):
    """Bytes that a failing test shows by their length and begin."""

    def __repr__(self) -> str:
        return f"{len(self)} bytes, {bytes(self[:40])!r}"


class Wire(asyncio.Transport):
    """A connection whose other end keeps what is written."""

    def __init__(self) -> None:
        super().__init__({"peername": ("127.0.0.1", 1), "sockname": ("127.0.0.1", 2)})
        self.written = b""
        self.is_ended = False

    def write(self, data: Any) -> None:
        assert not self.is_ended, "nothing is written after the end"
        self.written += data

    def writelines(self, pieces: Iterable[Any]) -> None:
        self.write(b"".join(pieces))

    def write_eof(self) -> None:
        self.is_ended = True

    def can_write_eof(self) -> bool:
        return True

    def close(self) -> None:
        self.is_ended = True

    abort = close

    def is_closing(self) -> bool:
        return False

    def pause_reading(self) -> None: ...

    def resume_reading(self) -> None: ...

    def get_write_buffer_size(self) -> int:
        return 0


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the number of headers and the length of the body."""
    request = Request(scope, receive)
    body = await request.body()
    await PlainTextResponse(f"<{len(scope['headers'])} {len(body)}>")(scope, receive, send)


async def answered(pieces: Sequence[bytes]) -> tuple[list[int], list[bytes]]:
    """Return the status of each response, and what the application saw of the requests it answered."""
    config = uvicorn.Config(echo, log_config=None, lifespan="off")
    connection = HttpProtocol(config, ServerState(), {}, connections=Connections(SETTINGS))
    wire = Wire()
    connection.connection_made(wire)
    for piece in pieces:
        connection.data_received(piece)
    quiet, written = 0, -1
    while quiet < 200:  # turns of the loop, of which each request needs a few
        quiet, written = quiet + 1 if len(wire.written) == written else 0, len(wire.written)
        await asyncio.sleep(0)
    connection.connection_lost(None)
    return [int(status) for status in RESPONSE.findall(wire.written)], re.findall(rb"<[^>]+>", wire.written)


def in_pieces(sent: bytes, lengths: Sequence[int]) -> list[bytes]:
    pieces: list[bytes] = []
    for length in lengths:
        pieces.append(sent[:length])
        sent = sent[length:]
    return [*filter(None, (*pieces, sent))]


def get(lines: int, size: int) -> bytes:
    """Return a request whose head has so many lines and so many bytes."""
    head = b"GET / HTTP/1.1\r\nhost: a\r\n" + b"x: y\r\n" * (lines - 3)
    return head + b"z: " + b"z" * (size - len(head) - 7) + b"\r\n\r\n"


def post(body: bytes) -> bytes:
    return b"POST / HTTP/1.1\r\nhost: a\r\ncontent-length: %d\r\n\r\n%b" % (len(body), body)


def chunked(*chunks: bytes, extension: bytes = b"", trailers: int = 0) -> bytes:
    parts = [b"%x%b\r\n%b\r\n" % (len(chunk), extension, chunk) for chunk in chunks]
    head = b"POST / HTTP/1.1\r\nhost: a\r\ntransfer-encoding: chunked\r\n\r\n"
    return head + b"".join(parts) + b"0\r\n" + b"authorization: t\r\n" * trailers + b"\r\n"


ACCEPTABLE = st.one_of(
    st.builds(get, st.integers(3, MAX_HEAD_LINES), st.integers(1000, MAX_HEAD_BYTES)),
    st.builds(get, st.integers(3, 50), st.integers(1000, 3000)).map((b"\r\n" * 10).__add__),
    st.builds(
        post, st.sampled_from((b"", b" " * 70_000, b"x", b"\r\n\r\n" * 30, b"\n" * 500, b"x" * 70_000))
    ),
    st.builds(
        chunked,
        st.sampled_from((b"x", b"\n" * 300, b"GET / HTTP/1.1\r\n\r\n", b"x" * 40_000)),
        st.just(b"y"),
        extension=st.sampled_from((b"", b";a=" + b"b" * 1000)),
        trailers=st.sampled_from((0, 50)),
    ),
).map(Sent)
LENGTHS = st.lists(st.one_of(st.integers(1, 4), st.integers(1, 3000), st.integers(1, 100_000)), max_size=30)


@given(st.lists(ACCEPTABLE, min_size=1, max_size=4), LENGTHS)
def test_requests_within_the_limits_are_answered_however_they_come(
    requests: list[bytes], lengths: list[int]
) -> None:
    whole = [asyncio.run(answered([one])) for one in requests]
    assert [statuses for statuses, _ in whole] == [[200]] * len(requests)
    statuses, seen = asyncio.run(answered(in_pieces(b"".join(requests), lengths)))
    assert statuses == [200] * len(requests)
    assert seen == [one for _, (one,) in whole]


@given(
    st.lists(ACCEPTABLE, max_size=3),
    st.sampled_from(
        (
            get(MAX_HEAD_LINES + 1, 2000),
            get(3, MAX_HEAD_BYTES + 1),
            get(3, MAX_HEAD_BYTES + 5)[:-4],
            get(MAX_HEAD_LINES + 2, 2000)[:-4],
            b"GET /" + b"x" * MAX_HEAD_BYTES,
            b"GET / HTTP/1.1\r\n" + b"x: " + b"y" * MAX_HEAD_BYTES,
            b"GET / HTTP/1.1\r\n" + b"x" * MAX_HEAD_BYTES,
            b"GET / HTTP/1.1\r\n" + b"cookie: a\r\n" * 200_000,
            b"\r\n" * 200_000,
        )
    ).map(Sent),
    LENGTHS,
)
def test_a_head_beyond_the_limits_is_refused_after_the_responses_before(
    before: list[bytes], refused: bytes, lengths: list[int]
) -> None:
    statuses, _ = asyncio.run(answered(in_pieces(b"".join(before) + refused, lengths)))
    assert statuses == [*([200] * len(before)), 431]


@given(
    st.sampled_from(
        (
            chunked(b"x", extension=b";a=" + b"b" * 200_000),
            chunked(b"x", trailers=MAX_HEAD_LINES * 100),
            chunked(b"x")[:-2] + b"x: " + b"y" * 200_000,
        )
    ).map(Sent),
    LENGTHS,
)
def test_what_a_body_has_between_its_chunks_is_limited(refused: bytes, lengths: list[int]) -> None:
    statuses, _ = asyncio.run(answered(in_pieces(refused, lengths)))
    assert statuses == [431]


def test_trailers_are_no_headers_of_the_request() -> None:
    _, (seen,) = asyncio.run(answered([chunked(b"x", trailers=5)]))
    assert seen == b"<2 1>"


@given(LENGTHS)
def test_more_requests_than_may_wait_are_answered_in_turn(lengths: list[int]) -> None:
    count = 3 * MAX_PIPELINED
    sent = b"".join(post(b"x" * number) for number in range(count)) + get(3, MAX_HEAD_BYTES + 1)
    statuses, seen = asyncio.run(answered(in_pieces(sent, lengths)))
    assert statuses == [*([200] * count), 431]
    assert seen == [f"<2 {number}>".encode() for number in range(count)]


@pytest.mark.parametrize("sent", [b"\r\n" * 500_000, b"\x16\x03\x01\x02", b"\x00" * 100_000])
def test_what_is_no_request_gets_no_success(sent: bytes) -> None:
    statuses, _ = asyncio.run(answered([sent]))
    assert set(statuses) <= {400, 431}
