"""The stream of speed limits to one robot: its controller ages them by itself when this process is gone."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import orjson
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from handover.control.latest_input import LatestInput
from handover.errors import HandoverError
from handover.network.tls_trust import tls_of
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_body.metrics import REPORTS
from handover_datamodels.streams import SpeedLimitReport

log = get_logger(__name__)

OPEN_TIMEOUT_S: Final = 3.0
MAX_ANSWER_BYTES: Final = 16 * 1024


class RobotStream:
    """Sends the newest report to the WebSocket `url`; `headers` are asked for each connection.

    `problem` says why the robot gets no limits, empty while it does.
    """

    def __init__(
        self, url: str, headers: Callable[[], Awaitable[Mapping[str, str]]], ca_files: Sequence[Path] = ()
    ) -> None:
        self.problem = "not connected yet"
        self._url = url
        self._headers = headers
        self._ca_files = ca_files
        self._reports = LatestInput()

    def put(self, report: SpeedLimitReport) -> None:
        """Send a report, unless a newer one replaces it before."""
        self._reports.put(report.model_dump_json(by_alias=True, exclude_none=True))

    async def run(self) -> None:
        """Connect and send until cancelled."""
        backoff = Backoff()
        while True:
            try:
                async with connect(
                    self._url,
                    additional_headers=await self._headers(),
                    ssl=tls_of(self._url, self._ca_files),
                    proxy=None,
                    compression=None,
                    open_timeout=OPEN_TIMEOUT_S,
                    max_size=MAX_ANSWER_BYTES,
                ) as link:
                    self.problem = ""
                    await self._serve(link, backoff)
                    self._failed(link.close_reason or "the robot closed the connection")
            except InvalidStatus as refused:
                self._failed(f"the trajectory tool answered {refused.response.status_code}")
            except (OSError, TimeoutError, InvalidHandshake, HandoverError) as error:
                self._failed(str(error) or type(error).__name__)
            await backoff.wait()

    async def _serve(self, link: ClientConnection, backoff: Backoff) -> None:
        sending = asyncio.create_task(self._send(link))
        try:
            async for text in link:
                answer = orjson.loads(text)
                if answer.get("accepted"):
                    REPORTS.labels("accepted").inc()
                    self.problem = ""
                    backoff.reset()
                else:
                    REPORTS.labels("refused").inc()
                    self._failed(str(answer.get("reason", "refused"))[:200])
        except (ConnectionClosed, orjson.JSONDecodeError):
            return
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    async def _send(self, link: ClientConnection) -> None:
        while True:
            await link.send(await self._reports.next())

    def _failed(self, problem: str) -> None:
        if problem != self.problem:
            log.warning("speed limits do not reach the robot", url=self._url, reason=problem)
        self.problem = problem
