"""Notifications: what a broker sends to a subscriber, read with care.

They are hints only: late, doubled, lost or made up. What cannot be read is refused with the reason and
counted; what can be read is still checked against the broker by whoever acts on it.
"""

from typing import Any

import orjson
from fastapi import Request
from prometheus_client import Counter

from handover.errors import Problem

MAX_BYTES = 10 * 1024 * 1024

REFUSED = Counter("handover_notifications_refused_total", "Notifications that could not be read", ["reason"])


async def notified_entities(request: Request) -> list[dict[str, Any]]:
    """Return the entities that the notification `request` carries.

    Raises `Problem` 400 when it cannot be read, 413 when it is too large.
    """
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BYTES:
            raise _refuse("too large", 413, f"a notification holds at most {MAX_BYTES} bytes")
    try:
        notification = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise _refuse("not JSON", 400, f"the body is not JSON: {error}") from None
    data = notification.get("data") if isinstance(notification, dict) else None
    if not isinstance(data, list) or not all(isinstance(entity, dict) for entity in data):
        raise _refuse("no data", 400, 'an NGSI-LD notification is an object with the entities in "data"')
    return data


def _refuse(reason: str, status: int, detail: str) -> Problem:
    REFUSED.labels(reason).inc()
    return Problem(status, "Notification refused", detail)
