"""The stream of speed limits of human state, followed by the controller of one robot.

The controller never waits for it: it uses what was received last and ages it with its own clock. So a human
state that is killed lowers the limit and then stops the robot, without a message.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import orjson
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, WebSocketException

from handover.control.speed_limits import Allowed, RefusedReport, SpeedLimits
from handover.errors import HandoverError
from handover.network.tls_trust import tls_of
from handover.runtime.retry import Backoff
from handover_datamodels.streams import SpeedLimitReport

OPEN_TIMEOUT_S: Final = 3.0
REPORT_PERIOD_S: Final = 0.25
"""Limits come 20 times a second; they are stale after 3 s, the least that a limit may have."""

Headers = Callable[[], Awaitable[Mapping[str, str]]]
Serve = Callable[[ClientConnection], Awaitable[None]]


async def keep_connected(
    url: str,
    serve: Serve,
    *,
    headers: Headers,
    ca_files: Sequence[Path],
    on_problem: Callable[[str], None],
    peer: str = "human state",
) -> None:
    """Serve connection after connection to the WebSocket `url`, a stream of `peer`, until cancelled.

    `on_problem` gets why one ended; the next is opened after a pause.
    """
    backoff = Backoff()
    while True:
        try:
            async with connect(
                url,
                additional_headers=dict(await headers()),
                ssl=tls_of(url, ca_files),
                proxy=None,
                compression=None,
                open_timeout=OPEN_TIMEOUT_S,
            ) as link:
                backoff.reset()
                await serve(link)
                on_problem(f"{peer} closed the connection")
        except InvalidStatus as refused:
            path = url.partition("://")[2].partition("/")[2]
            on_problem(f"{peer} answered {refused.response.status_code} at /{path}")
        except (
            *(OSError, TimeoutError, InvalidHandshake, HandoverError, ConnectionClosed),
            *(KeyError, TypeError, ValueError),
        ) as error:
            on_problem(f"{peer}: {str(error) or type(error).__name__}"[:200])
        await backoff.wait()


async def exchange(
    link: ClientConnection, send: Coroutine[Any, Any, None], take: Callable[[str | bytes], None]
) -> None:
    """Take each message of a connection while `send` sends, until the peer ends it; then `send` is
    cancelled."""
    sending = asyncio.create_task(send)
    try:
        async for received in link:
            take(received)
    finally:
        sending.cancel()
        with suppress(asyncio.CancelledError, WebSocketException):
            await sending


class LimitLink:
    """The limits of `robot`, from human state at `url`.

    `problem` says why nothing is received, "" while it is. `required` are the sources without
    which the robot does not move.
    """

    def __init__(
        self,
        url: str,
        robot: str,
        *,
        headers: Headers,
        ca_files: Sequence[Path] = (),
        required: Iterable[str] = (),
    ) -> None:
        self.problem = "not connected to human state yet"
        self.limits = SpeedLimits(required, time.monotonic())
        self._url = f"{url.replace('http', 'ws', 1)}/limits?robot={quote(robot)}"
        self._headers, self._ca_files = headers, ca_files

    def allowed(self, now_s: float) -> Allowed | None:
        """Return the least limit at `now_s`, None without a source."""
        return min(self.limits.allowed(now_s), key=lambda limit: limit.fraction, default=None)

    async def run(self) -> None:
        """Follow the stream until cancelled."""
        await keep_connected(
            self._url,
            self._follow,
            headers=self._headers,
            ca_files=self._ca_files,
            on_problem=self._set_problem,
        )

    def take(self, document: Mapping[str, Any]) -> None:
        """Take a message of the stream. Raises `KeyError`, `TypeError` or `ValueError` for another one."""
        now_s = time.monotonic()
        for limit in document["limits"]:
            report = SpeedLimitReport(
                source=limit["source"],
                stamp=document["stamp"],
                fraction=limit["fraction"],
                reason=limit["reason"],
                period=REPORT_PERIOD_S,
            )
            with suppress(RefusedReport):  # a stamp that does not advance: the limit ages
                self.limits.receive(report, now_s, time.time())

    async def _follow(self, link: ClientConnection) -> None:
        async for text in link:
            self.problem = ""
            self.take(orjson.loads(text))

    def _set_problem(self, problem: str) -> None:
        self.problem = problem
