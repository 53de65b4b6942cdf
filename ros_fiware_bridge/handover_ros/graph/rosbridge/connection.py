"""One WebSocket to a rosbridge server, which reconnects with backoff.

It implements the rosbridge protocol, version 2: JSON objects with an operation code `op`.
"""

import asyncio
import itertools
import json
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import orjson
import structlog
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidURI, WebSocketException

from handover.runtime.retry import Backoff
from handover_ros.errors import (
    AdapterUnavailable,
    ClosedUnanswered,
    GraphClosed,
    PublishBlocked,
    ServerLost,
)
from handover_ros.graph.waiting import until

log = structlog.get_logger(__name__)

Operation = Mapping[str, Any]
OPEN_TIMEOUT_S = 5.0
INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 5.0
FRAGMENT_CHARACTERS = 512 * 1024
"""Larger messages are requested in fragments, so that one over the limit does not close the connection."""
MAX_CHARACTERS_PER_BYTE = 5
"""A float64 such as -0.12345678901234567 has three JSON characters for each of its bytes."""


class Connection:
    """The connection to the server at `url`; `max_message_bytes` limits the size of a message."""

    def __init__(self, url: str, max_message_bytes: int) -> None:
        self.url = url
        self.lost = 0
        self.refused = 0
        self.last_error: str | None = None
        self._max_characters = max_message_bytes * MAX_CHARACTERS_PER_BYTE
        self._handlers: dict[str, list[Callable[[Operation], None]]] = {}
        self._openings: list[Callable[[], None]] = []
        self._answers: dict[str, asyncio.Future[Operation]] = {}
        self._numbers = itertools.count(1)
        self._out: deque[bytes] = deque()
        self._out_bytes = 0
        self._has_output = asyncio.Event()
        self._parts: dict[str, dict[int, str]] = {}
        self._socket: ClientConnection | None = None
        self._connection_task: asyncio.Task[None] | None = None
        self._closed = False

    async def open(self) -> None:
        """Connect for the first time. Raises `AdapterUnavailable`."""
        try:
            self._socket = await self._connected()
        except (OSError, TimeoutError, WebSocketException, InvalidURI) as error:
            raise AdapterUnavailable(
                f"no rosbridge server answers at {self.url}: {str(error) or type(error).__name__}; start it "
                "(ros2 launch rosbridge_server rosbridge_websocket_launch.xml), or set HANDOVER_ROSBRIDGE_URL"
            ) from None
        self._connection_task = asyncio.create_task(self._stay_connected())

    async def close(self) -> None:
        """Close the connection; pending requests end with `ClosedUnanswered`."""
        self._closed = True
        if self._connection_task is not None:
            await until(lambda: not (self._out and self.is_open), 1.0)  # send what is queued
            self._connection_task.cancel()
            with suppress(asyncio.CancelledError):
                await self._connection_task
        if self._socket is not None:
            await self._socket.close()
            self._socket = None
        self._fail_pending(ClosedUnanswered("the graph was closed"))

    @property
    def is_open(self) -> bool:
        """Return whether the connection is open."""
        return self._socket is not None

    def new_id(self, what: str) -> str:
        """Return an id that is unique on this connection."""
        return f"{what}:{next(self._numbers)}"

    def on(self, op: str, handler: Callable[[Operation], None]) -> None:
        """Call `handler` with every received operation `op`."""
        self._handlers.setdefault(op, []).append(handler)

    def off(self, op: str, handler: Callable[[Operation], None]) -> None:
        """Remove a handler."""
        with suppress(ValueError, KeyError):
            self._handlers[op].remove(handler)

    def on_opening(self, repeat: Callable[[], None]) -> None:
        """Call `repeat` after every reconnect: a server forgets the state of a lost connection."""
        self._openings.append(repeat)

    def off_opening(self, repeat: Callable[[], None]) -> None:
        """Remove a function that `on_opening` added."""
        with suppress(ValueError):
            self._openings.remove(repeat)

    def send(self, **operation: Any) -> None:
        """Queue an operation. Raises `PublishBlocked` if the server is unavailable or too slow."""
        if self._closed:
            raise GraphClosed("the graph was closed")
        if not self.is_open:
            raise PublishBlocked(f"the rosbridge server at {self.url} is unavailable; reconnecting")
        written = orjson.dumps(operation, option=orjson.OPT_SERIALIZE_NUMPY)
        if self._out_bytes + len(written) > self._max_characters:
            raise PublishBlocked(f"the rosbridge server at {self.url} reads too slowly")
        self._out.append(written)
        self._out_bytes += len(written)
        self._has_output.set()

    async def request(self, timeout_s: float | None, **operation: Any) -> Operation:
        """Send an operation and return the response with the same id.

        Raises `TimeoutError`, `ServerLost` (the connection was lost), `PublishBlocked` (it was not sent).
        """
        answer: asyncio.Future[Operation] = asyncio.get_running_loop().create_future()
        self._answers[operation["id"]] = answer
        try:
            self.send(**operation)
            async with asyncio.timeout(timeout_s):
                return await answer
        finally:
            self._answers.pop(operation["id"], None)

    async def _connected(self) -> ClientConnection:
        return await connect(self.url, open_timeout=OPEN_TIMEOUT_S, max_size=self._max_characters, proxy=None)

    async def _stay_connected(self) -> None:
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            if self._socket is not None:
                backoff.reset()
                await self._exchange(self._socket)
                self._socket = None
                self.lost += 1
                self._out.clear()
                self._out_bytes = 0
                self._parts.clear()
                self._fail_pending(ServerLost(f"the connection to {self.url} was lost"))
            await backoff.wait()
            try:
                self._socket = await self._connected()
            except (OSError, TimeoutError, WebSocketException) as error:
                log.info("rosbridge server unavailable", url=self.url, error=str(error))
                continue
            for repeat in list(self._openings):
                repeat()

    async def _exchange(self, socket: ClientConnection) -> None:
        """Read and write until the connection is lost."""
        writing = asyncio.create_task(self._write(socket))
        try:
            async for text in socket:
                self._take(text)
        except WebSocketException as error:
            log.info("connection to the rosbridge server lost", url=self.url, error=str(error))
        finally:
            writing.cancel()
            with suppress(asyncio.CancelledError, WebSocketException):
                await writing

    async def _write(self, socket: ClientConnection) -> None:
        while True:
            while not self._out:
                self._has_output.clear()
                await self._has_output.wait()
            written = self._out[0]
            await socket.send(written, text=True)
            self._out.popleft()
            self._out_bytes -= len(written)

    def _take(self, text: str | bytes) -> None:
        try:
            operation = orjson.loads(text)
        except orjson.JSONDecodeError:
            try:
                operation = json.loads(text)  # servers of ROS 1 write NaN, which is not JSON
            except ValueError:
                operation = None
        if not isinstance(operation, dict):
            self._refuse(f"a message of {self.url} is not JSON, or not an operation")
            return
        if operation.get("op") == "fragment":
            self._take_part(operation)
            return
        answer = self._answers.get(str(operation.get("id")))
        if answer is not None and operation.get("op") in {"service_response", "action_result"}:
            if not answer.done():
                answer.set_result(operation)
            return
        if operation.get("op") == "status" and operation.get("level") in {"error", "warning"}:
            self._refuse(f"{self.url} reports: {str(operation.get('msg'))[:300]}")
        for handler in list(self._handlers.get(str(operation.get("op")), ())):
            try:
                handler(operation)
            except Exception as error:  # one operation must not end the connection
                self._refuse(f"{operation.get('op')}: {type(error).__name__}: {error}")
                log.exception("processing an operation of the rosbridge server failed")

    def _take_part(self, part: Operation) -> None:
        """Join the fragments of a message, unless it is over the limit."""
        whole, data, number, total = (part.get(name) for name in ("id", "data", "num", "total"))
        if not isinstance(data, str) or not isinstance(number, int) or not isinstance(total, int):
            self._refuse("a fragment has no number, total or data")
            return
        if total * FRAGMENT_CHARACTERS > self._max_characters + FRAGMENT_CHARACTERS:
            if number == total - 1:
                self._refuse(f"a message of about {total * FRAGMENT_CHARACTERS} characters is too large")
            return
        parts = self._parts.setdefault(str(whole), {})
        parts[number] = data
        if len(parts) == total:
            del self._parts[str(whole)]
            self._take("".join(parts[place] for place in sorted(parts)))

    def _refuse(self, why: str) -> None:
        self.refused += 1
        self.last_error = why
        log.warning("rosbridge message refused", reason=why)

    def _fail_pending(self, why: Exception) -> None:
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(why)
