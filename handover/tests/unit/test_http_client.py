"""The HTTP client: connections that the other side has closed."""

import asyncio
import socket
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from handover.network.http_client import (
    Address,
    BodyReadingHttpClient,
    ResponseTimeout,
    SendError,
    StreamingHttpClient,
)
from handover.network.http_connections import MAX_WAITING_BYTES
from handover.transport_security.server_certificate import ServerCertificate
from tests.kit.certificates import Certificates
from tests.kit.waiting import until

_ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok"


async def test_a_connection_that_was_closed_unnoticed_is_not_used_for_a_post() -> None:
    closed, listener = threading.Event(), socket.create_server(("127.0.0.1", 0))
    connections: list[bytes] = []

    def serve() -> None:
        for _ in range(3):
            connection, _ = listener.accept()
            with connection:
                connections.append(connection.recv(4096))
                connection.sendall(_ANSWER)
            closed.set()  # although it could be kept open

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    client = BodyReadingHttpClient()
    for _ in range(3):
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/"
        answer = await client.request("POST", url, [], b"", 10)
        assert (answer.status, answer.body) == (200, b"ok")
        closed.wait(10)  # the event loop is busy meanwhile
        closed.clear()
    server.join(10)
    assert len(connections) == 3
    client.close()
    listener.close()


async def test_a_streamed_response_waits_for_its_reader_and_gives_its_connection_back() -> None:
    part, parts = b"x" * 65536, 64
    sent, connections = 0, 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal sent, connections
        connections += 1
        for _ in range(2):
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"HTTP/1.1 200 OK\r\nX-Kept: As It Is\r\nTransfer-Encoding: chunked\r\n\r\n")
            for _ in range(parts):
                writer.write(b"10000\r\n" + part + b"\r\n")
                await writer.drain()
                sent += 1
            writer.write(b"0\r\n\r\n")
        writer.close()
        await writer.wait_closed()

    server = await asyncio.start_server(serve, "127.0.0.1", 0, limit=65536)
    url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
    client = StreamingHttpClient()
    for _ in range(2):
        sent = 0
        answer = await client.stream("GET", url, [], b"", 30)
        assert (answer.status, dict(answer.headers)[b"X-Kept"]) == (200, b"As It Is")
        await asyncio.sleep(0.3)  # nobody reads: the server stops once the buffers are full
        waiting = answer._connection
        assert waiting is not None
        assert waiting._waiting_bytes < MAX_WAITING_BYTES + 1024 * 1024
        assert answer.whole() is None
        assert sum([len(one) async for one in answer.chunks(30)]) == parts * len(part)
        answer.close()
    assert connections == 1
    client.close()
    server.close()


async def test_a_streamed_response_that_breaks_off_or_stops_is_an_error_and_is_not_reused() -> None:
    connections = ended = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections, ended
        connections += 1
        request = await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 10\r\n\r\nhalf")
        if b"/broken" not in request:
            with suppress(ConnectionError):
                await reader.read()  # until the client gives up
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()
        ended += 1

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    client = StreamingHttpClient()
    for path, error in (("/broken", SendError), ("/silent", ResponseTimeout)):
        answer = await client.stream("GET", url + path, [], b"", 30)
        chunks = answer.chunks(0.2 if path == "/silent" else 30)
        assert await anext(chunks) == b"half"
        with pytest.raises(error):
            await anext(chunks)
        answer.close()
    assert connections == 2
    client.close()
    server.close()
    await until(lambda: ended == 2)


async def test_a_server_with_a_known_name_is_reached_at_any_address(tmp_path: Path) -> None:
    files = Certificates(tmp_path).make("device-gateway")
    certificate = ServerCertificate(files.certificate, files.key)
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        for _ in range(2):
            plain, _address = listener.accept()
            with plain, suppress(OSError), certificate.context.wrap_socket(plain, True) as connection:
                connection.recv(4096)
                connection.sendall(_ANSWER)
                connection.recv(1)  # until the client has closed

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    client = BodyReadingHttpClient(ca_files=[files.authority])
    port = listener.getsockname()[1]
    where = Address("127.0.0.1", port, True, "/", "device-gateway", tls_name="device-gateway")
    assert (await client.request("GET", where, [], b"", 60)).body == b"ok"
    client.close()
    with pytest.raises(SendError, match="certificate"):
        await client.request("POST", replace(where, tls_name="accounts"), [], b"", 60)
    assert certificate.name == "device-gateway", "which a replica publishes for the others"
    client.close()
    await asyncio.to_thread(server.join, 60)
    listener.close()
