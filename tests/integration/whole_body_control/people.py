"""People at a humanoid, as WebSocket clients."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event
from typing import Any

import orjson
from websockets.sync.client import ClientConnection, connect

from tests.integration.whole_body_control.conftest import SERVICE, WITHIN_S, HumanoidCell
from tests.kit.waiting import wait_for

PERIOD_S = 0.03
THROW_S = 6.0
"""In the time of the robot, from the request until the arm is back."""


def socket_url(humanoid: HumanoidCell, path: str) -> str:
    """Return the URL of a WebSocket of the service."""
    return f"{humanoid.cell.url(SERVICE).replace('http', 'ws', 1)}{path}"


def stands(humanoid: HumanoidCell) -> bool:
    """Return whether the robot stands on both feet."""
    return bool(humanoid.state()["phase"] == "standing")


class Therapist:
    """Holds the dead-man control."""

    def __init__(self, humanoid: HumanoidCell, socket: ClientConnection) -> None:
        self._humanoid, self._socket = humanoid, socket

    def release(self) -> None:
        """Let the control go."""
        self._send(held=False)

    def hold(self, velocity: dict[str, float], until: Callable[[], bool], *, again: bool = True) -> None:
        """Hold it with a velocity until a condition.

        When messages were late on a slow machine, it is released and held `again`.
        """

        def is_reached() -> bool:
            if again and self._humanoid.state()["needsRelease"]:
                self.release()
            for _ in range(3):
                self._send(**velocity, held=True)
                time.sleep(PERIOD_S)
            return until()

        wait_for(is_reached, WITHIN_S, "what the therapist waits for")

    def _send(self, **message: Any) -> None:
        self._socket.send(orjson.dumps({"kind": "wish", **message}).decode())


@contextmanager
def therapist_at(humanoid: HumanoidCell) -> Iterator[Therapist]:
    """Connect a therapist, whose control is released."""
    with connect(socket_url(humanoid, "/input?role=therapist"), proxy=None) as socket:
        therapist = Therapist(humanoid, socket)
        therapist.release()
        yield therapist


def resume(humanoid: HumanoidCell) -> None:
    """Resume a session that has paused, since poses were late on a slow machine."""
    session = humanoid.state()["session"]
    if session is not None and session["state"] == "paused":
        humanoid.http.post(f"/sessions/{session['id']}/resume")


@contextmanager
def leading_patient(humanoid: HumanoidCell) -> Iterator[None]:
    """Connect a patient who pulls softly ahead at both hands of the robot."""
    is_ended = Event()
    pull = orjson.dumps({"kind": "pull", "left": [6.0, 0.0, 0.0], "right": [6.0, 0.0, 0.0]}).decode()

    def lead() -> None:
        with connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as patient:
            while not is_ended.wait(PERIOD_S):
                patient.send(pull)

    with ThreadPoolExecutor(1) as thread:
        leading = thread.submit(lead)
        try:
            yield
        finally:
            is_ended.set()
            leading.result()


@contextmanager
def catching_patient(humanoid: HumanoidCell) -> Iterator[None]:
    """Connect a patient whose right hand is where the ball is to land."""
    is_ended = Event()

    def catch() -> None:
        with (
            connect(socket_url(humanoid, "/live?hz=60"), proxy=None) as live,
            connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as patient,
        ):
            while not is_ended.is_set():
                state = orjson.loads(live.recv(timeout=WITHIN_S))
                ball = state["ball"]
                place = (
                    None if ball is None else ball["target"]
                )  # a hand that follows comes late on a slow machine
                hand = {"position": place or [0.8, 0.0, 0.6], "grip": 0.0}
                pose = {"kind": "pose", "t": time.monotonic(), "hands": {"right": hand}}
                patient.send(orjson.dumps(pose).decode())

    with ThreadPoolExecutor(1) as thread:
        catching = thread.submit(catch)
        try:
            yield
        finally:
            is_ended.set()
            catching.result()
