"""The WebSocket of people who exercise or steer. Nothing queues: each message replaces the one before."""

import asyncio
import math
from contextlib import suppress
from typing import Any, Final

import orjson
from fastapi import FastAPI, WebSocket
from pydantic import ValidationError
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocketDisconnect

from handover.errors import Problem
from handover.formats.validation import fault_text
from handover.messages import message, with_code
from handover.security.guard import require_by_request
from handover.security.permissions import Permission
from handover_humanoid.metrics import INPUTS
from handover_humanoid.routes.access import of_humanoid
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.inputs import (
    MESSAGES,
    PoseMessage,
    PullMessage,
    Turns,
    WishMessage,
)
from handover_humanoid.running.motion import Motion
from handover_humanoid.running.sessions.signals import PatientSignals

MAX_MESSAGE_CHARS: Final = 4096
MAX_REASON_CHARS: Final = 300
SAME_SPEED: Final = 1e-6
"""In m/s or rad/s."""
TAKEN: Final = {
    "patient": message("humanoid.patient_taken", "another person exercises already; wait for their end"),
    "therapist": message("humanoid.therapist_taken", "another therapist steers already; wait for their end"),
}
_NEEDED: Final[dict[str, Permission]] = {
    "patient": Permission.PERFORM_TASKS,
    "therapist": Permission.MOVE_ROBOTS,
}


def _role(connection: HTTPConnection) -> str:
    role = connection.query_params.get("role", "patient")
    if role not in _NEEDED:
        raise Problem(400, "Unknown role", 'the role is "patient" or "therapist"')
    return role


def _needed(connection: HTTPConnection) -> Permission:
    return _NEEDED[_role(connection)]


def add_input_socket(app: FastAPI, control: HumanoidControl, signals: PatientSignals) -> None:
    """Add the WebSocket of inputs."""
    turns = {"patient": Turns(), "therapist": control.steering}

    @app.websocket(
        "/input",
        dependencies=[
            require_by_request(
                _needed,
                of_humanoid,
                least=Permission.PERFORM_TASKS,
                shown="for the Device of the humanoid; a therapist needs `moveRobots`",
            )
        ],
    )
    async def inputs(socket: WebSocket) -> None:
        """Take poses and pulls of the patient, or wishes of the therapist.

        Answers are echoes and haptic pulses, and what is walked of a wish where that is less.
        """
        await socket.accept()
        role = _role(socket)
        sending = asyncio.create_task(_send_signals(socket, signals)) if role == "patient" else None
        try:
            with suppress(WebSocketDisconnect, RuntimeError, KeyError):
                while True:
                    answer = _take(control, role, turns[role], socket, await socket.receive_text())
                    if answer is not None:
                        await socket.send_text(orjson.dumps(answer).decode())
        finally:
            turns[role].leave(socket)
            if sending is not None:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)


def _take(control: HumanoidControl, role: str, turns: Turns, who: object, text: str) -> dict[str, Any] | None:
    """Take a message; return the answer, if it has one."""
    received = _read(text, role)
    if isinstance(received, str) or not turns.takes(who):
        INPUTS.labels("refused").inc()
        return {
            "kind": "error",
            **with_code("reason", received if isinstance(received, str) else TAKEN[role]),
        }
    INPUTS.labels("accepted").inc()
    if isinstance(received, WishMessage):
        control.motion.walk(received.ahead, received.left, received.yaw, is_held=received.held)
        return shortfall(control.motion, received)
    control.receive(received)
    return {"kind": "echo", "t": received.t} if isinstance(received, PoseMessage) else None


def shortfall(motion: Motion, wish: WishMessage) -> dict[str, Any] | None:
    """Return what is walked of a wish that is held, and why, if that is less; else None."""
    wanted, walked = (wish.ahead, wish.left, wish.yaw), motion.walked
    is_same = all(math.isclose(*pair, abs_tol=SAME_SPEED) for pair in zip(wanted, walked, strict=True))
    if is_same or not wish.held:
        return None
    ahead, left, yaw = (round(velocity, 4) for velocity in walked)
    return {"kind": "walked", "ahead": ahead, "left": left, "yaw": yaw, "because": motion.why_less()}


def _read(text: str, role: str) -> PoseMessage | PullMessage | WishMessage | str:
    """Return the message, or what is wrong with it."""
    if len(text) > MAX_MESSAGE_CHARS:
        return f"a message has at most {MAX_MESSAGE_CHARS} characters"
    try:
        received: PoseMessage | PullMessage | WishMessage = MESSAGES.validate_json(text, strict=True)
    except ValidationError as error:
        return fault_text(error)[:MAX_REASON_CHARS]
    if isinstance(received, WishMessage) is not (role == "therapist"):
        return f'a {role} does not send "{received.kind}"'
    return received


async def _send_signals(socket: WebSocket, signals: PatientSignals) -> None:
    with suppress(WebSocketDisconnect, RuntimeError), signals.receiver() as waiting:
        while True:
            await socket.send_text(orjson.dumps(await waiting.get()).decode())
