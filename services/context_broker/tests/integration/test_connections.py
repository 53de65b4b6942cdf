"""Connections as bytes: requests in pieces, pipelined requests, slow and disconnecting clients."""

import json
import socket
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from services.context_broker.tests.integration.conftest import BrokerProcess


class EndpointQueue:
    """One connection."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=120)
        self._kept = b""

    def send(self, *pieces: bytes) -> None:
        for piece in pieces:
            self.socket.sendall(piece)

    def answer(self, *, has_body: bool = True) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body of the next answer."""
        while b"\r\n\r\n" not in self._kept:
            self._more()
        head, _, self._kept = self._kept.partition(b"\r\n\r\n")
        first, *rest = head.decode().split("\r\n")
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in rest)}
        length = int(headers.get("content-length", "0")) if has_body else 0
        while len(self._kept) < length:
            self._more()
        body, self._kept = self._kept[:length], self._kept[length:]
        return int(first.split()[1]), headers, body

    def is_closed(self) -> bool:
        """Return whether the broker closes the connection without more data."""
        return self._kept == b"" and self.socket.recv(1) == b""

    def _more(self) -> None:
        piece = self.socket.recv(65536)
        assert piece, f"the broker hung up after {self._kept!r}"
        self._kept += piece


@pytest.fixture
def line(shared_broker: BrokerProcess) -> Iterator[EndpointQueue]:
    """A connection to the shared broker."""
    line = EndpointQueue(shared_broker.port)
    yield line
    line.socket.close()


def get(path: str, *headers: str) -> bytes:
    return "\r\n".join([f"GET {path} HTTP/1.1", "Host: 127.0.0.1", *headers, "", ""]).encode()


def post(entity_id: str, *headers: str, value: Any = 1) -> bytes:
    body = json.dumps({"id": entity_id, "type": "Wire", "a": {"type": "Property", "value": value}}).encode()
    head = ["POST /ngsi-ld/v1/entities HTTP/1.1", "Host: 127.0.0.1", "Content-Type: application/json"]
    return "\r\n".join([*head, f"Content-Length: {len(body)}", *headers, "", ""]).encode() + body


def test_requests_in_one_piece_are_answered_one_after_the_other(line: EndpointQueue) -> None:
    names = [f"urn:ngsi-ld:Wire:row:{number}" for number in range(40)]
    asked = b"".join(
        post(name) + get(f"/ngsi-ld/v1/entities/{name}") + get("/healthz") + get("/ngsi-ld/v1/nothing")
        for name in names
    )
    line.send(asked)
    for name in names:
        assert line.answer()[1]["location"].endswith(name)
        status, _, body = line.answer()
        assert (status, json.loads(body)["id"]) == (200, name), "it reads what was written just before"
        assert json.loads(line.answer()[2]) == {"status": "ok"}
        assert line.answer()[0] == 404


def test_thousands_of_requests_in_a_row_are_no_matter(line: EndpointQueue) -> None:
    count = 4000
    line.send(get("/ngsi-ld/v1/entities/urn:ngsi-ld:Wire:nobody") * count)
    assert {line.answer()[0] for _ in range(count)} == {404}


def test_a_request_may_come_byte_by_byte(line: EndpointQueue) -> None:
    line.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    line.send(*(bytes([one]) for one in post("urn:ngsi-ld:Wire:bytes")))
    assert line.answer()[0] == 201


def test_a_body_of_a_megabyte_is_read_whole(line: EndpointQueue, http: httpx.Client) -> None:
    value = "x" * 1_000_000
    line.send(post("urn:ngsi-ld:Wire:large", value=value))
    assert line.answer()[0] == 201
    line.send(get("/ngsi-ld/v1/entities/urn:ngsi-ld:Wire:large"))
    assert json.loads(line.answer()[2])["a"]["value"] == value


def test_a_client_that_expects_100_continue_receives_it(line: EndpointQueue) -> None:
    head, _, body = post("urn:ngsi-ld:Wire:expects", "Expect: 100-continue").partition(b"\r\n\r\n")
    line.send(head + b"\r\n\r\n")
    assert line.answer(has_body=False)[0] == 100
    line.send(body)
    assert line.answer()[0] == 201


def test_a_request_refused_by_its_head_needs_no_body(line: EndpointQueue) -> None:
    head = b"POST /ngsi-ld/v1/entities HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    line.send(head + b"Content-Length: 99999999999\r\nExpect: 100-continue\r\n\r\n")
    assert line.answer()[0] == 413, "and no go-ahead before"


def test_the_connection_stays_usable_after_a_refused_body(line: EndpointQueue) -> None:
    line.send(
        b"POST /ngsi-ld/v1/entities HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n"
        b"5\r\nhello\r\n"
    )
    assert line.answer()[0] == 411
    line.send(b"5\r\nworld\r\n0\r\n\r\n", get("/ngsi-ld/v1/types"))
    assert line.answer()[0] == 200


def test_headers_that_come_twice_are_one(line: EndpointQueue) -> None:
    line.send(get("/ngsi-ld/v1/types", "Accept: text/plain", "Accept: application/json"))
    assert line.answer()[0] == 200


def test_connection_close_is_answered_first(shared_broker: BrokerProcess, line: EndpointQueue) -> None:
    line.send(post("urn:ngsi-ld:Wire:close", "Connection: close"))
    status, headers, _ = line.answer()
    assert (status, headers["connection"]) == (201, "close")
    assert line.is_closed()
    old = EndpointQueue(shared_broker.port)
    old.send(b"GET /ngsi-ld/v1/types HTTP/1.0\r\n\r\n")
    assert old.answer()[0] == 200
    assert old.is_closed()
    old.socket.close()


def test_head_has_no_body_and_the_next_answer_follows(line: EndpointQueue) -> None:
    line.send(get("/ngsi-ld/v1/types").replace(b"GET", b"HEAD", 1), get("/ngsi-ld/v1/types"))
    status, headers, _ = line.answer(has_body=False)
    assert status == 200
    assert int(headers["content-length"]) == len(line.answer()[2])


def test_invalid_http_is_refused(line: EndpointQueue) -> None:
    line.send(b"\x00 rubbish\r\n\r\n")
    assert line.answer()[0] == 400
    assert line.is_closed()


def test_no_other_protocol_is_spoken(line: EndpointQueue) -> None:
    line.send(get("/ngsi-ld/v1/types", "Connection: Upgrade", "Upgrade: h2c"))
    assert line.answer()[0] == 200, "as if it had not been asked for"


def test_a_slow_reader_gets_everything_and_blocks_no_other_client(
    line: EndpointQueue, http: httpx.Client
) -> None:
    value = "y" * 900_000
    line.send(post("urn:ngsi-ld:Wire:slow", value=value))
    assert line.answer()[0] == 201
    line.send(get("/ngsi-ld/v1/entities/urn:ngsi-ld:Wire:slow") * 20)
    assert http.get("/types").status_code == 200, "others are answered meanwhile"
    for _ in range(20):
        assert json.loads(line.answer()[2])["a"]["value"] == value


def test_a_write_of_a_disconnected_client_is_stored(shared_broker: BrokerProcess, http: httpx.Client) -> None:
    names = [f"urn:ngsi-ld:Wire:gone:{number}" for number in range(30)]
    hasty = EndpointQueue(shared_broker.port)
    hasty.send(b"".join(map(post, names)))
    assert hasty.answer()[0] == 201
    hasty.socket.close()
    assert http.get(f"/entities/{names[0]}").status_code == 200
    assert "Traceback" not in shared_broker.log()
