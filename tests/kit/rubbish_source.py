"""A context source that answers rubbish: arbitrary bytes, as slowly as a test wants, over plain TCP."""

import socket
import threading
import time
from collections.abc import Iterator


class RubbishSource:
    """Answers each request with `answer`, piece by piece with `pause_s` between, as long as there is any.

    It reads nothing but the head of a request. `closes`: the connection ends after the answer.
    """

    def __init__(self) -> None:
        self.answer: Iterator[bytes] | list[bytes] = []
        self.pause_s = 0.0
        self.closes = True
        self.sent = 0
        self.open = 0
        self._over = threading.Event()
        self._socket = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}"
        threading.Thread(target=self._serve, daemon=True).start()

    def says(self, *pieces: bytes, pause_s: float = 0.0, closes: bool = True) -> None:
        """Say how to answer from now on."""
        self.answer, self.pause_s, self.closes = list(pieces), pause_s, closes

    def stop(self) -> None:
        self._over.set()
        self._socket.close()

    def _serve(self) -> None:
        while not self._over.is_set():
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        self.open += 1
        try:
            with connection:
                connection.settimeout(30)
                connection.recv(65536)
                for piece in self.answer:
                    if self._over.is_set():
                        return
                    connection.sendall(piece)
                    self.sent += len(piece)
                    time.sleep(self.pause_s)
                if not self.closes:
                    self._over.wait(60)
        except OSError:
            pass  # the broker had enough
        finally:
            self.open -= 1
