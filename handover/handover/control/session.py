"""The WebSocket of a person who controls a robot: inputs in, the state of the robot out, until either ends.

A service brings the session, which moves the robot, and what happens to an input. The same rules hold for
every robot: the control ends when the person leaves, loses the lease or the permission, or sends nothing for
a long time. The robot has come to rest before `serve` returns.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, Final, Protocol

import orjson
from fastapi import WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from handover.control.leasing import REVOKED_CODE
from handover.errors import HandoverError
from handover.formats.validation import fault_text
from handover_datamodels.streams import HumanInput

STATE_EVERY_S: Final = 0.05
VALID_EVERY_S: Final = 0.1
MAX_SILENCE_S: Final = 30.0
"""Time without any input after which the control ends; the robot has stopped long before."""
MAX_MESSAGE_BYTES: Final = 4096
IDLE_CODE: Final = 4408

Ending = tuple[int, str]
"""The close code and the reason."""


class InputRefused(HandoverError):
    """An input that is not used; the message names the field and the rule."""


class Session(Protocol):
    """A person controls a robot, until `end`."""

    async def run(self) -> None:
        """Move the robot as the inputs say; return when it rests after `end`, or when it cannot move."""

    def end(self) -> None:
        """Let the robot come to rest."""

    def view(self) -> dict[str, Any]:
        """Return the state as JSON."""

    def silence_s(self) -> float:
        """Return the time since the last input."""


async def serve(
    socket: WebSocket,
    session: Session,
    receiving: Awaitable[None],
    may_continue: Callable[[], bool],
    *,
    motion_ended: Ending | None = None,
) -> Ending | None:
    """Serve a session until `receiving` returns, or the control ends; the robot rests then.

    Return why the socket should be closed: None if the client has left, `motion_ended` if `run` returned
    first.
    """
    motion = asyncio.create_task(session.run())
    work = [
        asyncio.ensure_future(receiving),
        asyncio.create_task(_send_states(socket, session)),
        asyncio.create_task(_watch(session, may_continue)),
    ]
    try:
        await asyncio.wait({motion, *work}, return_when=asyncio.FIRST_COMPLETED)
        has_motion_ended = motion.done()
    finally:
        session.end()
        for task in work:
            task.cancel()
        await asyncio.gather(*work, return_exceptions=True)
        await asyncio.shield(motion)
    if not may_continue():
        return REVOKED_CODE, "the permission to move this robot was removed, or cannot be verified"
    if session.silence_s() > MAX_SILENCE_S:
        return IDLE_CODE, f"no input arrived for {MAX_SILENCE_S:.0f} s"
    return motion_ended if has_motion_ended else None


async def receive_input(socket: WebSocket) -> HumanInput | None:
    """Return the next input, None if the client has left. Raises `InputRefused`."""
    try:
        text = await socket.receive_text()
    except (WebSocketDisconnect, RuntimeError, KeyError):  # KeyError: a binary message
        return None
    return read_input(text)


def read_input(text: str) -> HumanInput:
    """Return an input. Raises `InputRefused`, which names the invalid fields.

    Types are strict: a text such as "true" is no dead-man control that is held.
    """
    if len(text) > MAX_MESSAGE_BYTES:
        raise InputRefused(f"a message has at most {MAX_MESSAGE_BYTES} bytes")
    try:
        return HumanInput.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise InputRefused(fault_text(error)) from None


async def send_error(socket: WebSocket, reason: str) -> None:
    """Send the client why an input was refused, or what failed; one that has left is ignored."""
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_text(orjson.dumps({"type": "error", "reason": reason}).decode())


async def _send_states(socket: WebSocket, session: Session) -> None:
    while True:
        try:
            await socket.send_text(orjson.dumps(session.view()).decode())
        except (WebSocketDisconnect, RuntimeError):
            return
        await asyncio.sleep(STATE_EVERY_S)


async def _watch(session: Session, may_continue: Callable[[], bool]) -> None:
    while may_continue() and session.silence_s() <= MAX_SILENCE_S:  # noqa: ASYNC110 - time passes
        await asyncio.sleep(VALID_EVERY_S)
