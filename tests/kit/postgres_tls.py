"""TLS in front of a PostgreSQL server: the server of the wheel is built without it.

The start of TLS is that of PostgreSQL: a client asks for it in the first message and receives one byte, then
all is encrypted. What is inside goes unchanged to the server and back.
"""

import select
import socket
import socketserver
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import parse_qs, urlsplit

from handover.transport_security.local_authority import ServerFiles

_TLS_REQUEST, _GSS_REQUEST = 80877103, 80877104
_CHUNK = 65_536


@contextmanager
def tls_in_front_of(url: str, files: ServerFiles) -> Iterator[str]:
    """Offer the database at `url`, which has a socket in a folder, with TLS; yield its URL there."""
    parts = urlsplit(url)
    path = f"{parse_qs(parts.query)['host'][0]}/.s.PGSQL.5432"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files.certificate, files.key)

    class Session(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            while (request := int.from_bytes(self.request.recv(8, socket.MSG_WAITALL)[4:])) == _GSS_REQUEST:
                self.request.sendall(b"N")
            if request != _TLS_REQUEST:
                return  # a client that would send in plain text
            self.request.sendall(b"S")
            try:
                with (
                    context.wrap_socket(self.request, server_side=True) as client,
                    socket.socket(socket.AF_UNIX) as server,
                ):
                    server.connect(path)
                    _relay(client, server)
            except OSError:
                return  # the client has refused the certificate, or has gone

    class Front(socketserver.ThreadingTCPServer):
        daemon_threads = True
        block_on_close = False

    with Front(("127.0.0.1", 0), Session) as front:
        threading.Thread(target=front.serve_forever, daemon=True).start()
        try:
            yield f"postgresql://{parts.username}@localhost:{front.server_address[1]}{parts.path}"
        finally:
            front.shutdown()


def _relay(client: ssl.SSLSocket, server: socket.socket) -> None:
    while True:
        ready = [client] if client.pending() else select.select([client, server], [], [])[0]
        for source, target in ((client, server), (server, client)):
            if source in ready:
                data = source.recv(_CHUNK)
                if not data:
                    return
                target.sendall(data)
