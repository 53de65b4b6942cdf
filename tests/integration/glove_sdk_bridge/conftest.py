"""A controller's end of the line, which a test plays by hand: it accepts, answers, listens and hangs up."""

import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from glove_sdk_bridge.frames import Frame, Hello, parse_frame, parse_hello
from tests.kit.paths import REPOSITORY

ACK = b'{"type":"ack","version":1}\n'


@dataclass
class Visit:
    """One connection of a glove: its hello, its frames, and whether it has ended."""

    line: socket.socket
    hello: Hello | None = None
    frames: list[Frame] = field(default_factory=list)
    ended: bool = False

    def hang_up(self) -> None:
        """End the connection as a controller that is killed would, unless the glove has ended it."""
        with suppress(OSError):
            self.line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            self.line.shutdown(socket.SHUT_RDWR)

    def say(self, line: bytes) -> None:
        """Send a message to the glove."""
        self.line.sendall(line)


class Desk:
    """A TCP server that answers each hello with `answer` and takes down the frames that follow.

    Until it opens, it holds its port, where connections are refused.
    """

    def __init__(self, port: int = 0) -> None:
        self.answer = ACK
        self.visits: list[Visit] = []
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", port))
        self.port: int = self._server.getsockname()[1]

    def open(self) -> None:
        """Begin to accept."""
        self._server.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def frames(self) -> list[Frame]:
        """All frames, of all visits."""
        return [frame for visit in self.visits for frame in visit.frames]

    def close(self) -> None:
        """Be gone, and every connection with it."""
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for visit in self.visits:
            visit.hang_up()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                line, _ = self._server.accept()
                visit = Visit(line)
                self.visits.append(visit)
                threading.Thread(target=self._attend, args=(visit,), daemon=True).start()

    def _attend(self, visit: Visit) -> None:
        with suppress(OSError), visit.line, visit.line.makefile("rb") as lines:
            hello = lines.readline()
            if hello:
                visit.hello = parse_hello(hello)
                visit.line.sendall(self.answer)
            for line in lines:
                visit.frames.append(parse_frame(line))
        visit.ended = True


@pytest.fixture
def make_desk() -> Iterator[Callable[..., Desk]]:
    """Make a desk that is not open yet, at the port of one that is closed if one is given."""
    made: list[Desk] = []

    def make(port: int = 0) -> Desk:
        made.append(Desk(port))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def closed_desk(make_desk: Callable[..., Desk]) -> Desk:
    """A desk that is not open yet."""
    return make_desk()


@pytest.fixture
def desk(closed_desk: Desk) -> Desk:
    """A desk that is open."""
    closed_desk.open()
    return closed_desk


@pytest.fixture
def bridge() -> Iterator[Callable[..., "subprocess.Popen[bytes]"]]:
    """Start the bridge in a process of its own; what it complains of can be read from its stderr."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}
    with ExitStack() as started:

        def start(
            *words: str, python: Sequence[str] = (), cwd: Path | None = None, **variables: str
        ) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [sys.executable, *python, "-m", "glove_sdk_bridge", *words],
                env={**kept, "PYTHONPATH": str(REPOSITORY), **variables},
                cwd=cwd,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
            started.enter_context(process)
            started.callback(process.kill)
            return process

        yield start
