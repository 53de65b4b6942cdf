"""Live: what a screen follows while the hand moves, and the frames that a recorder takes down."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

import orjson
from fastapi import WebSocket, WebSocketDisconnect

from services.gesture_controller.glove import Glove
from services.gesture_controller.view import view_of

LEAST_PAUSE_S = 1 / 30
STILL_S = 1.0
"""A view is sent at least so often, for what changes by time alone."""

RECORDER_LAG = 2000
"""Frames that a recorder may be behind before it is told that it is too slow."""


async def follow(glove: Glove, screen: WebSocket) -> None:
    """Send the view of `glove` to `screen` whenever it has changed.

    A hand that moves is sent at most 30 times a second; what is asked, answered or lost at once.
    """
    await screen.accept()
    moved, matters = asyncio.Event(), asyncio.Event()

    def watch(more_than_a_movement: bool) -> None:
        moved.set()
        if more_than_a_movement:
            matters.set()

    glove.watchers.add(watch)
    sending = asyncio.create_task(_send(glove, screen, moved, matters))
    listening = asyncio.create_task(_until_closed(screen))
    forgotten = asyncio.create_task(glove.forgotten.wait())
    parts = {sending, listening, forgotten}
    try:
        await asyncio.wait(parts, return_when=asyncio.FIRST_COMPLETED)
    finally:
        glove.watchers.discard(watch)
        for half in parts:
            half.cancel()
        await asyncio.wait(parts)
        for half in parts:
            if not half.cancelled():
                half.exception()  # a screen that went away while it was being sent to is no fault
    if glove.forgotten.is_set():
        with suppress(RuntimeError, WebSocketDisconnect):
            await screen.close(4404, f"{glove.name} is not known any more")


async def frames_of(glove: Glove) -> AsyncIterator[bytes]:
    """Yield the glove's hello, then its frames as they came, one JSON object a line.

    A reader that falls behind gets an error line at its end, never a recording with silent holes.
    """
    lines: asyncio.Queue[bytes] = asyncio.Queue(RECORDER_LAG)

    def record(line: bytes) -> None:
        if lines.full():
            glove.recorders.discard(record)
        else:
            lines.put_nowait(line)

    yield glove.hello.line()
    glove.recorders.add(record)
    try:
        while record in glove.recorders or not lines.empty():
            yield (await lines.get()).rstrip(b"\r") + b"\n"
        reason = f"the reader is more than {RECORDER_LAG} frames behind; record to a faster disk or network"
        yield orjson.dumps({"type": "error", "reason": reason}) + b"\n"
    finally:
        glove.recorders.discard(record)


async def _send(glove: Glove, screen: WebSocket, moved: asyncio.Event, matters: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    while True:
        moved.clear()
        matters.clear()
        await screen.send_text(orjson.dumps(view_of(glove, loop.time())).decode())
        with suppress(TimeoutError):
            async with asyncio.timeout(LEAST_PAUSE_S):
                await matters.wait()
        with suppress(TimeoutError):
            async with asyncio.timeout(STILL_S):
                await moved.wait()


async def _until_closed(screen: WebSocket) -> None:
    with suppress(WebSocketDisconnect):
        while True:
            await screen.receive_text()
