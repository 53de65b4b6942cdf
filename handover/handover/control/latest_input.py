"""Inputs of a person that wait to be sent: the newest one counts, and nothing queues for a slow reader.

Every release is delivered before a later press, which must find a control that was released. So at most three
inputs wait: a release, an act of the gripper, and the newest other one, in this order.
"""

import asyncio
from typing import Final

import orjson

_RELEASE, _GRIPPER, _MOTION = range(3)
KINDS: Final = (_RELEASE, _GRIPPER, _MOTION)


class LatestInput:
    """Inputs as JSON text. Invalid ones are passed on, so that the service of the robot answers them."""

    def __init__(self) -> None:
        self._waiting: dict[int, str] = {}
        self._has_some = asyncio.Event()

    @property
    def has_some(self) -> bool:
        """Whether an input waits."""
        return bool(self._waiting)

    def put(self, text: str) -> None:
        """Add an input; it replaces older ones of its kind, and a release replaces older motions."""
        kind = _kind_of(text)
        if kind == _RELEASE:
            self._waiting.pop(_MOTION, None)
        self._waiting[kind] = text
        self._has_some.set()

    async def next(self) -> str:
        """Wait for an input and remove it."""
        await self._has_some.wait()
        kind = min(self._waiting)
        text = self._waiting.pop(kind)
        if not self._waiting:
            self._has_some.clear()
        return text


def _kind_of(text: str) -> int:
    try:
        document = orjson.loads(text)
    except orjson.JSONDecodeError:
        return _MOTION
    if not isinstance(document, dict):
        return _MOTION
    if document.get("gripper") is not None:
        return _GRIPPER
    return _MOTION if document.get("held") is True else _RELEASE
