"""Open streams: a WebSocket or a streamed response ends when its caller loses what it was opened with.

A token is checked when a connection opens, and a stream may stay open for hours. So the caller of each open
stream is checked every `CHECK_EVERY_S`, and within that time the stream ends

- when the session, the token or the user was revoked,
- when the permission that the route requires was removed, also if the credentials remain valid,
- when a secret token has expired,
- when the route changes or moves something and the revocations are not known any more, unless the caller is
  one of our services.

An access token that merely expires ends nothing: its session is still there, or was revoked. A handler sees
the end as a client that has disconnected.
"""

import asyncio
from contextlib import suppress
from typing import Any, Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from handover.errors import Problem
from handover.security.authentication import Guard
from handover.security.guard import still_allowed

CHECK_EVERY_S: Final = 0.5
_CODES_FROM: Final = 4000
"""A WebSocket is closed with 4000 plus the HTTP status, as one that is refused."""


class EndOfStreams:
    """ASGI middleware that ends the streams of callers who are no longer allowed to have them."""

    def __init__(self, app: ASGIApp, guard: Guard) -> None:
        self._app = app
        self._guard = guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "websocket":
            await _WebSocketStream(self._guard, scope, receive, send).run(self._app)
        elif scope["type"] == "http":
            await self._respond(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _respond(self, scope: Scope, receive: Receive, send: Send) -> None:
        watching: asyncio.Task[None] | None = None

        async def watch() -> None:
            await _until_ended(self._guard, scope)
            limit.reschedule(asyncio.get_running_loop().time())

        async def watched_send(message: Message) -> None:
            nonlocal watching
            if watching is None and message.get("more_body"):  # only a streamed response has a second part
                watching = asyncio.create_task(watch())
            await send(message)

        try:
            async with asyncio.timeout(None) as limit:
                await self._app(scope, receive, watched_send)
        except TimeoutError:
            if not limit.expired():
                raise
        finally:
            if watching is not None:
                watching.cancel()


class _WebSocketStream:
    """One WebSocket; after its end the handler receives a disconnect, and cannot send."""

    def __init__(self, guard: Guard, scope: Scope, receive: Receive, send: Send) -> None:
        self._guard = guard
        self._scope = scope
        self._receive = receive
        self._send = send
        self._is_open = False
        self._ended: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._receiving: set[asyncio.Timeout] = set()

    async def run(self, app: ASGIApp) -> None:
        watching = asyncio.create_task(self._watch())
        try:
            await app(self._scope, self._receive_until_ended, self._send_until_ended)
        finally:
            self._guard.places.free(self._scope)
            watching.cancel()
            self._ended.cancel()

    async def _watch(self) -> None:
        problem = await _until_ended(self._guard, self._scope)
        code = _CODES_FROM + problem.status
        was_open, self._is_open = self._is_open, False
        self._ended.set_result(code)
        for limit in self._receiving:
            limit.reschedule(asyncio.get_running_loop().time())
        if was_open:
            with suppress(OSError, RuntimeError):
                await self._send({"type": "websocket.close", "code": code, "reason": problem.title})

    async def _receive_until_ended(self) -> Message:
        if not self._ended.done():
            # Not a task for each message: a person who moves a robot sends 50 in a second.
            try:
                async with asyncio.timeout(None) as limit:
                    self._receiving.add(limit)
                    return await self._receive()
            except TimeoutError:
                if not self._ended.done():
                    raise
            finally:
                self._receiving.discard(limit)
        return {"type": "websocket.disconnect", "code": self._ended.result(), "reason": ""}

    async def _send_until_ended(self, message: Message) -> None:
        if self._ended.done():
            raise OSError("the stream was ended: its caller is no longer allowed to have it")
        if message["type"] == "websocket.accept":
            self._is_open = True
        elif message["type"] == "websocket.close":
            self._is_open = False
        await self._send(message)


async def _until_ended(guard: Guard, scope: Scope) -> Problem:
    """Return why the stream of a connection ends."""
    while True:
        await asyncio.sleep(CHECK_EVERY_S)
        try:
            await still_allowed(guard, scope)
        except Problem as problem:
            return problem
