"""The link: one WebSocket to a rosbridge server, opened again by itself whenever it was lost.

It speaks the rosbridge protocol, version 2: JSON objects whose `op` says what they are.
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

from handover.retry import Backoff
from ros_fiware_bridge.errors import AdapterUnavailable, GraphClosed, PublishBlocked, ServiceUnavailable
from ros_fiware_bridge.graph.waiting import until

log = structlog.get_logger(__name__)

Op = Mapping[str, Any]
OPEN_WITHIN_S = 5.0
INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 5.0
FRAGMENT_CHARACTERS = 512 * 1024
"""Servers are asked to send more than this in parts, so that a message too big does not end the link."""
MOST_PER_BYTE = 5
"""In characters of JSON: a float64 such as -0.12345678901234567 has three for each of its bytes."""


class Link:
    """The WebSocket to the server at `url`; `most_bytes` bounds a message either way."""

    def __init__(self, url: str, most_bytes: int) -> None:
        self.url = url
        self.lost = 0
        self.refused = 0
        self.last_error: str | None = None
        self._most = most_bytes * MOST_PER_BYTE
        self._handlers: dict[str, list[Callable[[Op], None]]] = {}
        self._openings: list[Callable[[], None]] = []
        self._answers: dict[str, asyncio.Future[Op]] = {}
        self._numbers = itertools.count(1)
        self._out: deque[bytes] = deque()
        self._out_bytes = 0
        self._something = asyncio.Event()
        self._parts: dict[str, dict[int, str]] = {}
        self._socket: ClientConnection | None = None
        self._life: asyncio.Task[None] | None = None
        self._closed = False

    async def open(self) -> None:
        """Open it for the first time. Raises `AdapterUnavailable`."""
        try:
            self._socket = await self._connected()
        except (OSError, TimeoutError, WebSocketException, InvalidURI) as error:
            raise AdapterUnavailable(
                f"no rosbridge server answers at {self.url}: {str(error) or type(error).__name__}; start it "
                "(ros2 launch rosbridge_server rosbridge_websocket_launch.xml), or set HANDOVER_ROSBRIDGE_URL"
            ) from None
        self._life = asyncio.create_task(self._live())

    async def close(self) -> None:
        """Close it; who still waits for an answer is told."""
        self._closed = True
        if self._life is not None:
            await until(lambda: not (self._out and self.is_open), 1.0)  # what was said last still goes out
            self._life.cancel()
            with suppress(asyncio.CancelledError):
                await self._life
        if self._socket is not None:
            await self._socket.close()
            self._socket = None
        self._tell_waiting(GraphClosed("the graph was closed"))

    @property
    def is_open(self) -> bool:
        """Say whether the server can be spoken to at this moment."""
        return self._socket is not None

    def new_id(self, what: str) -> str:
        """Return an id that no other operation of this link has."""
        return f"{what}:{next(self._numbers)}"

    def on(self, op: str, handler: Callable[[Op], None]) -> None:
        """Have `handler` called with every operation `op` that comes."""
        self._handlers.setdefault(op, []).append(handler)

    def off(self, op: str, handler: Callable[[Op], None]) -> None:
        """Have it called no more."""
        with suppress(ValueError, KeyError):
            self._handlers[op].remove(handler)

    def on_opening(self, repeat: Callable[[], None]) -> None:
        """Have `repeat` called whenever the link is opened again: a server forgets who was lost."""
        self._openings.append(repeat)

    def off_opening(self, repeat: Callable[[], None]) -> None:
        """Have it called no more."""
        with suppress(ValueError):
            self._openings.remove(repeat)

    def send(self, **operation: Any) -> None:
        """Send an operation, soon. Raises `PublishBlocked` when the server is away or takes too slowly."""
        if self._closed:
            raise GraphClosed("the graph was closed")
        if not self.is_open:
            raise PublishBlocked(f"the rosbridge server at {self.url} is away; it is asked again and again")
        written = orjson.dumps(operation, option=orjson.OPT_SERIALIZE_NUMPY)
        if self._out_bytes + len(written) > self._most:
            raise PublishBlocked(f"the rosbridge server at {self.url} takes too slowly what it is told")
        self._out.append(written)
        self._out_bytes += len(written)
        self._something.set()

    async def ask(self, timeout_s: float | None, **operation: Any) -> Op:
        """Send an operation and return the one with the same id that answers it.

        Raises `TimeoutError`, `ServiceUnavailable` (the link was lost), `PublishBlocked`.
        """
        answer: asyncio.Future[Op] = asyncio.get_running_loop().create_future()
        self._answers[operation["id"]] = answer
        try:
            self.send(**operation)
            async with asyncio.timeout(timeout_s):
                return await answer
        finally:
            self._answers.pop(operation["id"], None)

    async def _connected(self) -> ClientConnection:
        return await connect(self.url, open_timeout=OPEN_WITHIN_S, max_size=self._most, proxy=None)

    async def _live(self) -> None:
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            if self._socket is not None:
                backoff.reset()
                await self._speak(self._socket)
                self._socket = None
                self.lost += 1
                self._out.clear()
                self._out_bytes = 0
                self._parts.clear()
                self._tell_waiting(ServiceUnavailable(f"the link to {self.url} was lost"))
            await backoff.wait()
            try:
                self._socket = await self._connected()
            except (OSError, TimeoutError, WebSocketException) as error:
                log.info("the rosbridge server is away", url=self.url, error=str(error))
                continue
            for repeat in list(self._openings):
                repeat()

    async def _speak(self, socket: ClientConnection) -> None:
        """Read and write until the link is lost."""
        writing = asyncio.create_task(self._write(socket))
        try:
            async for text in socket:
                self._take(text)
        except WebSocketException as error:
            log.info("the link to the rosbridge server was lost", url=self.url, error=str(error))
        finally:
            writing.cancel()
            with suppress(asyncio.CancelledError, WebSocketException):
                await writing

    async def _write(self, socket: ClientConnection) -> None:
        while True:
            while not self._out:
                self._something.clear()
                await self._something.wait()
            written = self._out[0]
            await socket.send(written, text=True)
            self._out.popleft()
            self._out_bytes -= len(written)

    def _take(self, text: str | bytes) -> None:
        try:
            operation = orjson.loads(text)
        except orjson.JSONDecodeError:
            try:
                operation = json.loads(text)  # servers of ROS 1 write NaN, which is no JSON
            except ValueError:
                operation = None
        if not isinstance(operation, dict):
            self._refuse(f"what {self.url} sent is not JSON, or no operation")
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
            self._refuse(f"{self.url} says: {str(operation.get('msg'))[:300]}")
        for handler in list(self._handlers.get(str(operation.get("op")), ())):
            try:
                handler(operation)
            except Exception as error:  # one operation must not end the link
                self._refuse(f"{operation.get('op')}: {type(error).__name__}: {error}")
                log.exception("an operation of the rosbridge server was not dealt with")

    def _take_part(self, part: Op) -> None:
        """Put a message together that came in parts, unless it would be too big."""
        whole, data, number, total = (part.get(name) for name in ("id", "data", "num", "total"))
        if not isinstance(data, str) or not isinstance(number, int) or not isinstance(total, int):
            self._refuse("a part of a message came without its number, total or data")
            return
        if total * FRAGMENT_CHARACTERS > self._most + FRAGMENT_CHARACTERS:
            if number == total - 1:
                self._refuse(f"a message of some {total * FRAGMENT_CHARACTERS} characters is too big")
            return
        parts = self._parts.setdefault(str(whole), {})
        parts[number] = data
        if len(parts) == total:
            del self._parts[str(whole)]
            self._take("".join(parts[place] for place in sorted(parts)))

    def _refuse(self, why: str) -> None:
        self.refused += 1
        self.last_error = why
        log.warning("refused", why=why)

    def _tell_waiting(self, why: Exception) -> None:
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(why)
