"""Streams of reports over WebSocket: each message is answered, and messages beyond the rate are dropped."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

import orjson
from pydantic import BaseModel, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.control.speed_limits import RefusedReport
from handover.formats.validation import fault_text
from handover_robots.metrics import LIMIT_REPORTS

MAX_MESSAGE_BYTES = 16 * 1024
MAX_REPORTS_PER_S = 100

Report = TypeVar("Report", bound=BaseModel)


class Rate:
    """Counts messages in each second."""

    def __init__(self) -> None:
        self._second = 0
        self._count = 0

    def excess(self, now_s: float) -> int:
        """Count a message, and return how many more than permitted have arrived in this second."""
        second = int(now_s)
        self._count = self._count + 1 if second == self._second else 1
        self._second = second
        return max(self._count - MAX_REPORTS_PER_S, 0)


async def receive_reports(
    sender: WebSocket,
    kind: str,
    form: type[Report],
    receive: Callable[[Report], Awaitable[None]],
    max_bytes: int = MAX_MESSAGE_BYTES,
) -> None:
    """Receive reports of an accepted connection; `receive` may raise `RefusedReport` and `OSError`."""
    rate = Rate()
    try:
        while True:
            text = await sender.receive_text()
            excess = rate.excess(time.monotonic())
            if excess > 0:
                LIMIT_REPORTS.labels(kind, "dropped").inc()
                if excess == 1:
                    reason = f"more than {MAX_REPORTS_PER_S} messages in a second; the others are dropped"
                    await sender.send_text(_refusal(reason))
                await asyncio.sleep(0)  # other connections are read meanwhile
                continue
            answer, outcome = await _answer(text, form, receive, max_bytes)
            LIMIT_REPORTS.labels(kind, outcome).inc()
            await sender.send_text(answer)
    except (WebSocketDisconnect, RuntimeError, KeyError):
        return  # the sender has left, or sent bytes; its limits age out


async def _answer(
    text: str, form: type[Report], receive: Callable[[Report], Awaitable[None]], max_bytes: int
) -> tuple[str, str]:
    if len(text) > max_bytes:
        return _refusal(f"a message has at most {max_bytes} bytes"), "refused"
    try:
        report = form.model_validate_json(text, strict=True)
        await receive(report)
    except ValidationError as error:
        return _refusal(fault_text(error)), "refused"
    except RefusedReport as refused:
        return _refusal(str(refused)), "refused"
    except OSError as error:
        return _refusal(f"the source is required, and cannot be stored: {error.strerror}"), "accepted"
    values = report.model_dump()
    accepted = {"accepted": True, "source": values["source"], "stamp": values["stamp"]}
    return orjson.dumps(accepted).decode(), "accepted"


def _refusal(reason: str) -> str:
    return orjson.dumps({"accepted": False, "reason": reason}).decode()
