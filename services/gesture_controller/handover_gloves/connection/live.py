"""Live streams of a glove: its view for screens, and its raw frames for recorders."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress

import orjson
from fastapi import WebSocket, WebSocketDisconnect

from handover.http.websocket_closing import close_websocket
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.glove_view import view_of

MIN_SEND_INTERVAL_S = 1 / 30
MAX_SEND_INTERVAL_S = 1.0
"""A view is sent at least this often, for values that depend on the time only."""

MAX_RECORDER_LAG_FRAMES = 2000
"""A recorder that is further behind is ended with an error."""


async def send_views(glove: Glove, screen: WebSocket) -> None:
    """Send the view of `glove` to `screen` whenever it changes.

    Movements are sent at most 30 times a second; prompts, answers and losses at once.
    """
    await screen.accept()
    changed, is_urgent_change = asyncio.Event(), asyncio.Event()

    def watch(is_urgent: bool) -> None:
        changed.set()
        if is_urgent:
            is_urgent_change.set()

    glove.observers.watchers.add(watch)
    sending = asyncio.create_task(_send(glove, screen, changed, is_urgent_change))
    listening = asyncio.create_task(_until_closed(screen))
    forgotten = asyncio.create_task(glove.observers.forgotten.wait())
    tasks = {sending, listening, forgotten}
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        glove.observers.watchers.discard(watch)
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        for task in tasks:
            if not task.cancelled():
                task.exception()  # a screen that closes during a send is no error
    if glove.observers.forgotten.is_set():
        with suppress(RuntimeError, WebSocketDisconnect):
            await close_websocket(screen, 4404, f"{glove.name} is not known any more")


async def stream_frames(glove: Glove) -> AsyncIterator[bytes]:
    """Yield the hello of the glove, then its frames as received, one JSON object a line.

    A reader that falls behind gets an error line at the end, never a recording with gaps.
    """
    lines: asyncio.Queue[bytes] = asyncio.Queue(MAX_RECORDER_LAG_FRAMES)
    recorders = glove.observers.recorders

    def record(line: bytes) -> None:
        if lines.full():
            recorders.discard(record)
        else:
            lines.put_nowait(line)

    yield glove.connection.hello.line()
    recorders.add(record)
    try:
        while record in recorders or not lines.empty():
            yield (await lines.get()).rstrip(b"\r") + b"\n"
        limit = MAX_RECORDER_LAG_FRAMES
        reason = f"the reader is more than {limit} frames behind; record to a faster disk or network"
        yield orjson.dumps({"type": "error", "reason": reason}) + b"\n"
    finally:
        recorders.discard(record)


async def _send(
    glove: Glove, screen: WebSocket, changed: asyncio.Event, is_urgent_change: asyncio.Event
) -> None:
    loop = asyncio.get_running_loop()
    while True:
        changed.clear()
        is_urgent_change.clear()
        await screen.send_text(orjson.dumps(view_of(glove, loop.time())).decode())
        with suppress(TimeoutError):
            async with asyncio.timeout(MIN_SEND_INTERVAL_S):
                await is_urgent_change.wait()
        with suppress(TimeoutError):
            async with asyncio.timeout(MAX_SEND_INTERVAL_S):
                await changed.wait()


async def _until_closed(screen: WebSocket) -> None:
    with suppress(WebSocketDisconnect):
        while True:
            await screen.receive_text()
