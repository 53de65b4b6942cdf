"""People at a humanoid, as WebSocket clients."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from threading import Event
from typing import Any

import httpx
import orjson
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from services.whole_body_control.tests.integration.conftest import SERVICE, WITHIN_S, HumanoidCell
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


class Heart:
    """The heart of Aino, 40 years old, who uses the humanoid; human state measures it."""

    def __init__(self, humanoid: HumanoidCell, body: httpx.Client) -> None:
        self._humanoid, self._body = humanoid, body
        ends = (datetime.now(UTC) + timedelta(hours=1)).isoformat()
        self._put("/people/aino", {"age": 40})
        purposes = ["live", "speedLimits"]
        self._put("/people/aino/consent", {"purposes": purposes, "ends": ends, "givenBy": "Aino"})
        self.beats(65)
        self._put("/people/aino/robots/coman-1", {})

    def beats(self, bpm: float) -> None:
        """Let it beat at a rate from now on."""
        settings = {"signals": ["heartRate"], "packet_s": 0.1, "rest_bpm": bpm}
        self._put("/sensors/strap", {"person": "aino", "driver": "simulated", "settings": settings})

    def allows(self, fraction: float) -> bool:
        """Reset what has stopped the robot; return whether the limit allows more than a fraction."""
        self._body.post("/people/aino/limit/reset", json={"name": "Aino"})
        self._humanoid.http.post("/reset")
        limit: dict[str, Any] = self._humanoid.state()["limit"]
        return not limit["needsReset"] and limit["rule"].startswith("body-") and limit["factor"] > fraction

    def _put(self, path: str, body: Any) -> None:
        self._body.put(path, json=body).raise_for_status()


@contextmanager
def heart_at(humanoid: HumanoidCell) -> Iterator[Heart]:
    """Run human state with a calm person; afterwards the robot is free of its limits."""
    humanoid.cell.run("human_state")
    with httpx.Client(base_url=humanoid.cell.url("human_state"), trust_env=False, timeout=60) as body:
        yield Heart(humanoid, body)
    sources = [limit["source"] for limit in humanoid.http.get("/limits").json()]
    humanoid.cell.kill("human_state")

    def is_free() -> bool:  # what was received before the end may still be read, and bring a source back
        for source in sources:
            assert humanoid.http.delete(f"/limits/{source}").status_code in {204, 404}
        humanoid.http.post("/reset")
        return bool(humanoid.state()["limit"]["factor"] == 1.0)

    wait_for(is_free, WITHIN_S, "the sources of limits are removed")


@contextmanager
def leading_patient(humanoid: HumanoidCell) -> Iterator[None]:
    """Connect a patient who pulls softly ahead at both hands of the robot."""
    pull = orjson.dumps({"kind": "pull", "left": [6.0, 0.0, 0.0], "right": [6.0, 0.0, 0.0]}).decode()

    def lead(is_ended: Event) -> None:
        with connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as patient:
            while not is_ended.wait(PERIOD_S):
                patient.send(pull)

    with _meanwhile(lead):
        yield


@contextmanager
def catching_patient(humanoid: HumanoidCell) -> Iterator[None]:
    """Connect a patient whose right hand is where the ball is to land."""

    def catch(is_ended: Event) -> None:
        with (
            connect(socket_url(humanoid, "/live?hz=60"), proxy=None) as live,
            connect(socket_url(humanoid, "/input?role=patient"), proxy=None) as patient,
        ):
            while not is_ended.is_set():
                ball = orjson.loads(live.recv(timeout=WITHIN_S))["ball"]
                # A hand that follows the ball would come late on a slow machine.
                place = (ball or {}).get("target") or [0.8, 0.0, 0.6]
                hand = {"position": place, "grip": 0.0}
                pose = {"kind": "pose", "t": time.monotonic(), "hands": {"right": hand}}
                patient.send(orjson.dumps(pose).decode())

    with _meanwhile(catch):
        yield


@contextmanager
def _meanwhile(act: Callable[[Event], None]) -> Iterator[None]:
    """Let a person act in a thread until the event is set; who loses the connection connects again."""
    is_ended = Event()

    def keep_acting() -> None:
        while not is_ended.is_set():
            with suppress(ConnectionClosed, OSError):  # a TimeoutError is one, too
                act(is_ended)

    with ThreadPoolExecutor(1) as thread:
        acting = thread.submit(keep_acting)
        try:
            yield
        finally:
            is_ended.set()
            acting.result()
