"""The connection of a machine to human state: limits and values of its person, and what a simulated one does.

Three WebSockets, each reconnected by itself. The controller never waits for them: it uses what was received
last and ages it with its own clock. So a human state that is killed lowers the limit and then stops the
machine, without a message.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import orjson
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from datamodels.streams import SpeedLimitReport
from handover.control.speed_limits import Allowed, RefusedReport, SpeedLimits
from handover.errors import HandoverError, Problem
from handover.http_client import BodyReadingHttpClient, SendError
from handover.messages import message
from handover.retry import Backoff
from handover.telemetry import get_logger
from handover.tls_trust import tls_of
from services.assistive_devices.model.body import Body, read_body
from services.assistive_devices.model.sensor import Sensor

log = get_logger(__name__)

OPEN_TIMEOUT_S: Final = 3.0
ACTS_EVERY_S: Final = 0.1
REPEAT_ACTS_S: Final = 1.0
REPORT_PERIOD_S: Final = 0.25
"""Limits come 20 times a second; they are stale after 3 s, the least that a limit may have."""
NO_LIMIT: Final = "no limit received from human state yet"

RESET: Final = b'{"name":"person in charge"}'
RESET_TIMEOUT_S: Final = 5.0
RESET_ATTEMPTS: Final = 20

Headers = Callable[[], Awaitable[Mapping[str, str]]]
Serve = Callable[[ClientConnection], Awaitable[None]]


class BodyLink:
    """The state of one person for one machine.

    `robot` is the name to which the person is bound; `sensors`, simulated ones, receive what the person does.
    """

    def __init__(
        self,
        url: str,
        *,
        person: str,
        robot: str,
        sensors: Sequence[Sensor],
        headers: Headers,
        ca_files: Sequence[Path] = (),
    ) -> None:
        self.body = Body()
        self.problem = "not connected to human state yet"
        self._url = url
        self._base = url.replace("http", "ws", 1)
        self._http = BodyReadingHttpClient(ca_files=ca_files, max_response_bytes=64 * 1024)
        self._person, self._robot, self._sensors = person, robot, sensors
        self._headers = headers
        self._ca_files = ca_files
        self._acts: Mapping[str, Any] = {}
        self.limits = SpeedLimits((), time.monotonic())

    def allowed(self, now_s: float) -> Allowed:
        """Return the limit at `now_s`: the least of all persons who are bound; 0 before the first one."""
        allowed = self.limits.allowed(now_s)
        return (
            min(allowed, key=lambda one: one.fraction) if allowed else Allowed("body", 0.0, reason=NO_LIMIT)
        )

    def do(self, acts: Mapping[str, Any]) -> None:
        """Let the simulated person do this from now on."""
        self._acts = acts

    async def reset(self) -> None:
        """Release a stop, as a person in charge: at human state, then here. Raises `Problem` 409 or 503.

        Here the stop is released once the limit of human state has arrived.
        """
        url = f"{self._url}/people/{quote(self._person)}/limit/reset"
        headers = [("Content-Type", "application/json"), *(await self._headers()).items()]
        try:
            answer = await self._http.request("POST", url, headers, RESET, RESET_TIMEOUT_S)
        except (SendError, OSError) as error:
            raise Problem(503, "No human state", f"human state does not answer: {error}; start it") from None
        if answer.status >= 300:
            raise Problem(409, "Still stopped", _detail_of(answer.body))
        for _ in range(RESET_ATTEMPTS):
            if not self.limits.reset(time.monotonic()):
                return
            await asyncio.sleep(REPORT_PERIOD_S)
        reason = str(self.allowed(time.monotonic()).reason)
        raise Problem(
            409,
            "Still stopped",
            message(
                "case.still_stopped",
                "the limit still stops {robot}: {reason}",
                robot=self._robot,
                reason=reason,
            ),
        )

    def close(self) -> None:
        """Close the connections of requests."""
        self._http.close()

    async def run(self) -> None:
        """Keep the three connections until cancelled."""
        limits = f"/limits?robot={quote(self._robot)}"
        values = f"/people/{quote(self._person)}/values"
        async with asyncio.TaskGroup() as group:
            group.create_task(self._keep(limits, self._follow(self._take_limits)))
            group.create_task(self._keep(values, self._follow(self._take_values)))
            for sensor in self._sensors:
                path = f"/sensors/{quote(sensor.name)}/simulation"
                group.create_task(self._keep(path, partial(self._send_acts, sensor)))

    def _follow(self, take: Callable[[dict[str, Any]], None]) -> Serve:
        async def follow(link: ClientConnection) -> None:
            async for text in link:
                self.problem = ""
                take(orjson.loads(text))

        return follow

    def _take_limits(self, document: dict[str, Any]) -> None:
        now_s = time.monotonic()
        for one in document["limits"]:
            report = SpeedLimitReport(
                source=one["source"],
                stamp=document["stamp"],
                fraction=one["fraction"],
                reason=one["reason"],
                period=REPORT_PERIOD_S,
            )
            with suppress(RefusedReport):  # a stamp that does not advance: the limit ages
                self.limits.receive(report, now_s, time.time())

    def _take_values(self, document: dict[str, Any]) -> None:
        self.body = read_body(document["values"], time.monotonic())

    async def _send_acts(self, sensor: Sensor, link: ClientConnection) -> None:
        sent: Mapping[str, Any] = {}
        sent_s = 0.0
        while True:
            acts, now_s = sensor.taken(self._acts), time.monotonic()
            if acts and (acts != sent or now_s - sent_s > REPEAT_ACTS_S):
                await link.send(orjson.dumps(acts).decode())
                answer = orjson.loads(await link.recv())
                sent, sent_s = acts, now_s
                if not answer["accepted"]:
                    log.warning("simulated person does not act", reason=answer["reason"])
            await asyncio.sleep(ACTS_EVERY_S)

    async def _keep(self, path: str, serve: Serve) -> None:
        """Serve connection after connection; one that ends is opened again after a pause."""
        backoff, url = Backoff(), f"{self._base}{path}"
        while True:
            try:
                async with connect(
                    url,
                    additional_headers=dict(await self._headers()),
                    ssl=tls_of(url, self._ca_files),
                    proxy=None,
                    compression=None,
                    open_timeout=OPEN_TIMEOUT_S,
                ) as link:
                    backoff.reset()
                    await serve(link)
                    self.problem = "human state closed the connection"
            except InvalidStatus as refused:
                self.problem = f"human state answered {refused.response.status_code} at {path}"
            except (
                *(OSError, TimeoutError, InvalidHandshake, HandoverError, ConnectionClosed),
                *(KeyError, TypeError, ValueError),
            ) as error:
                self.problem = f"human state: {str(error) or type(error).__name__}"[:200]
            await backoff.wait()


def _detail_of(body: bytes) -> str:
    try:
        return str(orjson.loads(body)["detail"])
    except (ValueError, KeyError, TypeError):
        return "human state refused the reset"
