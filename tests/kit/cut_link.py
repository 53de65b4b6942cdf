"""A TCP link that a test can cut, mend, freeze and thaw: what was sent meanwhile then arrives late."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

CHUNK: Final = 65536


class CutLink:
    """Forwards connections to a port of this machine."""

    def __init__(self, target: int) -> None:
        self.target = target
        self.held_bytes = 0
        """Bytes to the client that wait while the link is frozen."""
        self.connections = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._lock = threading.Lock()
        self._is_cut = False
        self._flows = threading.Event()
        self._flows.set()
        self._sockets: set[socket.socket] = set()
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def cut(self) -> None:
        """End all connections, and new ones at once."""
        with self._lock:
            self._is_cut = True
            for one in self._sockets:
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """Forward connections again."""
        self._is_cut = False

    def freeze(self) -> None:
        """Keep the connections, and forward nothing."""
        self.held_bytes = 0
        self._flows.clear()

    def thaw(self) -> None:
        """Forward what was held."""
        self._flows.set()

    def close(self) -> None:
        """End everything."""
        self.cut()
        self.thaw()
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            if self._is_cut:
                near.close()
                continue
            try:
                far = socket.create_connection(("127.0.0.1", self.target))
            except OSError:
                near.close()
                continue
            with self._lock:
                self._sockets |= {near, far}
                self.connections += 1
            thread = threading.Thread(target=self._join, args=(near, far))
            self._threads.append(thread)
            thread.start()

    def _join(self, near: socket.socket, far: socket.socket) -> None:
        with near, far:
            answers = threading.Thread(target=self._forward, args=(far, near, True))
            answers.start()
            self._forward(near, far, False)
            answers.join()
            with self._lock:
                self._sockets -= {near, far}

    def _forward(self, source: socket.socket, target: socket.socket, is_answer: bool) -> None:
        with suppress(OSError):
            while data := source.recv(CHUNK):
                if is_answer and not self._flows.is_set():
                    self.held_bytes += len(data)
                self._flows.wait()
                target.sendall(data)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


@contextmanager
def cut_link(target: int) -> Iterator[CutLink]:
    """Run a link to a port."""
    link = CutLink(target)
    try:
        yield link
    finally:
        link.close()
