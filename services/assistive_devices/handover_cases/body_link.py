"""The connection of a machine to human state: limits and values of its person, and what a simulated one does.

Three WebSockets, each reconnected by itself. The controller never waits for them: it uses what was received
last and ages it with its own clock. So a human state that is killed lowers the limit and then stops the
machine, without a message.
"""

import asyncio
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import orjson
from websockets.asyncio.client import ClientConnection

from handover.control.limit_link import REPORT_PERIOD_S, Headers, LimitLink, Serve, keep_connected
from handover.control.speed_limits import Allowed, SpeedLimits
from handover.errors import Problem
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.telemetry import get_logger
from handover_cases.model.body import Body, read_body
from handover_cases.model.sensor import Sensor

log = get_logger(__name__)

ACTS_EVERY_S: Final = 0.1
REPEAT_ACTS_S: Final = 1.0
NO_LIMIT: Final = "no limit received from human state yet"

RESET: Final = b'{"name":"person in charge"}'
RESET_TIMEOUT_S: Final = 5.0
RESET_ATTEMPTS: Final = 20


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
        self._problem = "not connected to human state yet"
        self._url = url
        self._base = url.replace("http", "ws", 1)
        self._http = BodyReadingHttpClient(ca_files=ca_files, max_response_bytes=64 * 1024)
        self._person, self._robot, self._sensors = person, robot, sensors
        self._headers = headers
        self._ca_files = ca_files
        self._acts: Mapping[str, Any] = {}
        self._limit_link = LimitLink(url, robot, headers=headers, ca_files=ca_files)

    @property
    def limits(self) -> SpeedLimits:
        """The limits by source."""
        return self._limit_link.limits

    @property
    def problem(self) -> str:
        """Why nothing is received from human state, "" while it is."""
        return self._problem or self._limit_link.problem

    def allowed(self, now_s: float) -> Allowed:
        """Return the limit at `now_s`: the least of all persons who are bound; 0 before the first one."""
        return self._limit_link.allowed(now_s) or Allowed("body", 0.0, reason=NO_LIMIT)

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
        raise Problem.translated(
            409,
            "Still stopped",
            "case.still_stopped",
            "the limit still stops {robot}: {reason}",
            robot=self._robot,
            reason=reason,
        )

    def close(self) -> None:
        """Close the connections of requests."""
        self._http.close()

    async def run(self) -> None:
        """Keep the three connections until cancelled."""
        values = f"/people/{quote(self._person)}/values"
        async with asyncio.TaskGroup() as group:
            group.create_task(self._limit_link.run())
            group.create_task(self._keep(values, self._follow_values))
            for sensor in self._sensors:
                path = f"/sensors/{quote(sensor.name)}/simulation"
                group.create_task(self._keep(path, partial(self._send_acts, sensor)))

    async def _follow_values(self, link: ClientConnection) -> None:
        async for text in link:
            self._problem = ""
            self.body = read_body(orjson.loads(text)["values"], time.monotonic())

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
        await keep_connected(
            f"{self._base}{path}",
            serve,
            headers=self._headers,
            ca_files=self._ca_files,
            on_problem=self._set_problem,
        )

    def _set_problem(self, problem: str) -> None:
        self._problem = problem


def _detail_of(body: bytes) -> str:
    try:
        return str(orjson.loads(body)["detail"])
    except (ValueError, KeyError, TypeError):
        return "human state refused the reset"
