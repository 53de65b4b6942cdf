"""The HTTP client: connections that the other side has closed."""

import socket
import threading

from handover.http_client import BodyReadingHttpClient

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
