"""Listeners with and without TLS: clients that are many or slow do not keep others out.

A listener accepts up to `MAX_ACCEPTED_AT_ONCE` connections in a turn of the event loop. The loop's own
servers accept one, so that a client waits behind hundreds of others for as many turns.

With TLS, handshakes are bounded in time and number.
A connection belongs to the protocol of the application only after its handshake. Until then it counts as
pending. A listener has at most `MAX_PENDING` of them; beyond that, the oldest handshake of the address that
has most of them is ended. So one address cannot keep out the others.
"""

import asyncio
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Final, Protocol

from prometheus_client import Counter

from handover.telemetry import get_logger
from handover.transport_security.server_certificate import CertificateInvalid, ServerCertificate

log = get_logger(__name__)

MAX_PENDING: Final = 1000
DEFAULT_HANDSHAKE_TIMEOUT_S: Final = 10.0
MAX_ACCEPTED_AT_ONCE: Final = 128
ACCEPT_RETRY_S: Final = 0.1
RELOAD_EVERY_S: Final = 2.0
SHUTDOWN_TIMEOUT_S: Final = 5.0
"""How long a closed connection may wait for the answer of the other side."""

HANDSHAKES = Counter("handover_tls_handshakes_total", "TLS handshakes by outcome", ["outcome"])


class Listener(Protocol):
    """A listening server, with or without TLS."""

    @property
    def sockets(self) -> Any:
        """The listening sockets."""

    def close(self) -> None:
        """Stop to listen."""

    async def wait_closed(self) -> None:
        """Wait until it is closed."""


async def listen(
    make_protocol: Callable[[], asyncio.Protocol],
    host: str,
    port: int,
    certificate: ServerCertificate | None,
    *,
    handshake_timeout_s: float = DEFAULT_HANDSHAKE_TIMEOUT_S,
    backlog: int = 1024,
    max_pending: int = MAX_PENDING,
) -> Listener:
    """Listen on `host` and `port`, with TLS if there is a certificate; raises `OSError`.

    A changed certificate is used for new connections. `make_protocol` is called for each connection, with TLS
    after the handshake. Its `connection_made` gets a transport with the address of the client and, with TLS,
    an `ssl_object`.
    """
    loop = asyncio.get_running_loop()
    sockets = await _listening(host, port, backlog)
    if certificate is None:
        return _PlainListener(sockets, make_protocol, loop)
    pending = _PendingHandshakes(make_protocol, certificate, handshake_timeout_s, max_pending)
    return _TlsListener(sockets, pending)


async def _listening(host: str, port: int, backlog: int) -> list[socket.socket]:
    """Return sockets that listen on all addresses of `host`, with the options of `asyncio.create_server`."""
    addresses = await asyncio.get_running_loop().getaddrinfo(
        host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )
    sockets: list[socket.socket] = []
    try:
        for family, kind, protocol, _, address in dict.fromkeys(addresses):
            listener = socket.socket(family, kind, protocol)
            sockets.append(listener)
            if os.name == "posix":
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            listener.bind(address)
            listener.listen(backlog)
            listener.setblocking(False)
    except OSError:
        for listener in sockets:
            listener.close()
        raise
    return sockets


class _PlainListener:
    def __init__(
        self,
        sockets: list[socket.socket],
        make_protocol: Callable[[], asyncio.Protocol],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self.sockets = sockets
        self._make_protocol = make_protocol
        self._loop = loop
        self._opening: set[asyncio.Task[Any]] = set()
        for listener in sockets:
            self._listen(listener)

    def close(self) -> None:
        for listener in self.sockets:
            self._loop.remove_reader(listener)
            listener.close()
        self.sockets = []

    async def wait_closed(self) -> None:
        await asyncio.gather(*self._opening, return_exceptions=True)

    def _listen(self, listening: socket.socket) -> None:
        if listening in self.sockets:
            self._loop.add_reader(listening, self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
        try:
            for _ in range(MAX_ACCEPTED_AT_ONCE):
                connection, _ = listening.accept()
                connection.setblocking(False)
                task = self._loop.create_task(self._open(connection))
                self._opening.add(task)
                task.add_done_callback(self._opening.discard)
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            pass
        except OSError as error:  # too many open files
            log.debug("connection not accepted", error=str(error))
            self._loop.remove_reader(listening)
            self._loop.call_later(ACCEPT_RETRY_S, self._listen, listening)

    async def _open(self, connection: socket.socket) -> None:
        try:
            await self._loop.connect_accepted_socket(self._make_protocol, connection)
        except OSError as error:  # the client has gone
            log.debug("connection not opened", error=str(error))
            connection.close()


class _TlsListener:
    def __init__(self, sockets: list[socket.socket], pending: "_PendingHandshakes") -> None:
        self.sockets = sockets
        self._pending = pending
        self._tasks = [asyncio.create_task(self._accept(listener)) for listener in sockets]
        self._tasks.append(asyncio.create_task(self._reload()))

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        self._pending.close()

    async def wait_closed(self) -> None:
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _reload(self) -> None:
        while True:
            await asyncio.sleep(RELOAD_EVERY_S)
            with suppress(CertificateInvalid):  # `CertificateWatch` reports it
                self._pending.certificate.reload()

    async def _accept(self, listening: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        with listening:
            while True:
                try:
                    for _ in range(MAX_ACCEPTED_AT_ONCE):
                        connection, peer = await loop.sock_accept(listening)
                        self._pending.start(connection, str(peer[0]) if isinstance(peer, tuple) else "")
                except OSError as error:  # too many open files, or the client has gone
                    log.debug("connection not accepted", error=str(error))
                    await asyncio.sleep(ACCEPT_RETRY_S)
                await asyncio.sleep(0)  # open connections take their turn in a flood of new ones


class _PendingHandshakes:
    """The handshakes of a listener that have not ended, oldest first for each address."""

    def __init__(
        self,
        make_protocol: Callable[[], asyncio.Protocol],
        certificate: ServerCertificate,
        timeout_s: float,
        max_pending: int,
    ) -> None:
        self._make_protocol = make_protocol
        self.certificate = certificate
        self._timeout_s = timeout_s
        self._max_pending = max_pending
        self._by_address: dict[str, dict[asyncio.Task[None], None]] = {}
        self._count = 0

    def start(self, connection: socket.socket, address: str) -> None:
        """Start the handshake of a new connection; end the oldest one of an address if there are too many."""
        task = asyncio.get_running_loop().create_task(self._handshake(connection))
        task.add_done_callback(partial(self._ended, address, connection))
        self._by_address.setdefault(address, {})[task] = None
        self._count += 1
        if self._count > self._max_pending:
            most = max(self._by_address, key=lambda candidate: len(self._by_address[candidate]))
            oldest = next(iter(self._by_address[most]))
            self._remove(most, oldest)
            HANDSHAKES.labels("too many").inc()
            oldest.cancel()

    def close(self) -> None:
        for of_address in self._by_address.values():
            for task in of_address:
                task.cancel()

    def _ended(self, address: str, connection: socket.socket, task: asyncio.Task[None]) -> None:
        self._remove(address, task)
        if task.cancelled():
            connection.close()

    def _remove(self, address: str, task: asyncio.Task[None]) -> None:
        of_address = self._by_address.get(address, {})
        if task in of_address:
            del of_address[task]
            self._count -= 1
            if not of_address:
                del self._by_address[address]

    async def _handshake(self, connection: socket.socket) -> None:
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                self._make_protocol,
                connection,
                ssl=self.certificate.context,
                ssl_handshake_timeout=self._timeout_s,
                ssl_shutdown_timeout=SHUTDOWN_TIMEOUT_S,
            )
        except OSError as error:  # an ssl.SSLError is one, and so is the timeout
            outcome = "timeout" if isinstance(error, ConnectionAbortedError) else "failed"
            log.debug("TLS handshake failed", error=str(error))
        else:
            outcome = "completed"
        HANDSHAKES.labels(outcome).inc()
