"""A glove for tests: a TCP client with a clock of its own."""

import socket
from types import TracebackType
from typing import Any, Self

import orjson

from tests.kit.waiting import scaled

STRAIGHT, BENT = 2000, 100


class TcpGlove:
    """Shows hands to the controller; its clock runs as fast as frames are sent.

    Use it in a `with` statement: a socket that a failed test leaves open is a warning in a later test.
    """

    def __init__(self, port: int, name: str = "glove-1", hand: str = "right", token: str = "") -> None:
        self.link = socket.create_connection(("127.0.0.1", port), timeout=scaled(10))
        try:
            self.link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.t_s = 0.0
            self.say({"type": "hello", "version": 1, "glove": name, "hand": hand, "token": token})
            self.answer = orjson.loads(self.link.recv(4096))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def show(self, code: str, seconds: float) -> None:
        """Make five finger states for `seconds` of its own time, at 50 Hz."""
        bend = [STRAIGHT if state == "0" else BENT for state in code]
        frames = []
        for _ in range(round(seconds * 50)):
            self.t_s = round(self.t_s + 0.02, 3)
            frames.append(orjson.dumps({"type": "frame", "t": self.t_s, "bend": bend}) + b"\n")
        self.link.sendall(b"".join(frames))

    def say(self, what: dict[str, Any]) -> None:
        """Send one line."""
        self.link.sendall(orjson.dumps(what) + b"\n")

    def close(self) -> None:
        """Hang up."""
        self.link.close()
