"""Ten thousand connections that say nothing cannot keep a working glove away."""

import json
import resource
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]

CONNECTIONS = 10_000
OPEN_AT_ONCE = 1_500


@pytest.fixture
def many_files() -> Iterator[None]:
    """Allow this process as many open connections as the test needs."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = OPEN_AT_ONCE + 500
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(needed, hard)), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


class WorkingGlove:
    """A glove that sends 50 frames a second until it is stopped."""

    def __init__(self, port: int) -> None:
        self.sent, self.broken = 0, ""
        self._stop = threading.Event()
        self._link = socket.create_connection(("127.0.0.1", port), timeout=120)
        self._say({"type": "hello", "version": 1, "glove": "glove-1", "hand": "right"})
        assert b'"ack"' in self._link.recv(4096)
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join(timeout=120)
        self._link.close()

    def _work(self) -> None:
        while not self._stop.wait(0.02):
            try:
                self._say({"type": "frame", "seq": self.sent, "t": self.sent * 0.02, "bend": [900] * 5})
            except OSError as error:
                self.broken = str(error)
                return
            self.sent += 1

    def _say(self, words: dict[str, Any]) -> None:
        self._link.sendall(json.dumps(words).encode() + b"\n")


def test_ten_thousand_connections_do_not_disturb_a_working_glove(
    cell: Any, many_files: None, eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "gesture_controller")
    state = f"{cell.url('gesture_controller')}/gloves/glove-1"
    glove = WorkingGlove(cell.ports["glove"])
    crowd: deque[socket.socket] = deque()
    try:
        for _ in range(CONNECTIONS):
            crowd.append(socket.create_connection(("127.0.0.1", cell.ports["glove"]), timeout=120))
            if len(crowd) > OPEN_AT_ONCE:
                crowd.popleft().close()
        before = glove.sent
        eventually(lambda: glove.broken or glove.sent > before + 50)
        assert not glove.broken, glove.broken
        eventually(lambda: httpx.get(state, timeout=120).json()["frames"] > before + 40)
        seen = httpx.get(state, timeout=120).json()
        assert seen["connected"]
        assert seen["dropped"] in (0, {}), seen
    finally:
        glove.stop()
        for stranger in crowd:
            stranger.close()
    cell.wait_ready("gesture_controller")
