"""The connection to the control WebSocket of a service: inputs to it, the states of the robot from it.

Inputs do not queue: while the service does not read, only the newest one waits (`LatestInput`). The dead-man
function stays with the service: when this connection ends, or no input arrives, the robot stops.
"""

import asyncio
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from handover.control.latest_input import LatestInput
from handover.network.tls_trust import tls_of

OPEN_TIMEOUT_S: Final = 3.0
CLOSE_TIMEOUT_S: Final = 1.0
MAX_STATE_BYTES: Final = 64 * 1024
SEND_BUFFER_BYTES: Final = 16 * 1024
"""Of the socket, so that few inputs wait in it for a service that does not read."""
UNAVAILABLE_CODE: Final = 4502
"""The close code for a service that does not answer."""


@dataclass(frozen=True, slots=True)
class Ended:
    """Why a control ended: the close code and the reason of its WebSocket."""

    code: int
    reason: str


class ControlLink:
    """A control over the WebSocket at `url`; `on_message` gets each message of the service."""

    def __init__(
        self,
        url: str,
        headers: Mapping[str, str],
        on_message: Callable[[str], object],
        ca_files: Sequence[Path] = (),
    ) -> None:
        self._url = url
        self._headers = headers
        self._on_message = on_message
        self._ca_files = ca_files
        self._inputs = LatestInput()

    def put(self, text: str) -> None:
        """Send an input, unless a newer one replaces it before."""
        self._inputs.put(text)

    async def run(self) -> Ended:
        """Connect and pass on messages until the service ends the control; cancel it to end it."""
        try:
            tls = tls_of(self._url, self._ca_files)
            opening = connect(
                self._url,
                additional_headers=self._headers,
                ssl=tls,
                proxy=None,
                compression=None,
                open_timeout=OPEN_TIMEOUT_S,
                close_timeout=CLOSE_TIMEOUT_S,
                max_size=MAX_STATE_BYTES,
                write_limit=1,
            )
            async with opening as link:
                return await self._serve(link)
        except InvalidStatus as refused:
            status = refused.response.status_code
            return Ended(4000 + status, "the service refused the control")
        except (OSError, TimeoutError, InvalidHandshake) as error:
            return Ended(UNAVAILABLE_CODE, f"the service of the robot does not answer: {error}"[:120])

    async def _serve(self, link: ClientConnection) -> Ended:
        raw = link.transport.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        sending = asyncio.create_task(self._send(link))
        try:
            async for text in link:
                if isinstance(text, str):
                    self._on_message(text)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)
        return Ended(link.close_code or UNAVAILABLE_CODE, link.close_reason or "")

    async def _send(self, link: ClientConnection) -> None:
        while True:
            await link.send(await self._inputs.next())
