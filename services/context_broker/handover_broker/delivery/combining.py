"""Combines the notifications of the changes of one request into one message for each subscription.

The changes of a request have the same time, which is stored with each pending notification, so they are
combined after a restart, too. They are written, counted as pending and deleted one by one.
"""

from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any, Final

import orjson

from handover_broker.delivery.endpoint_queue import WINDOW
from handover_broker.storage.entries import PendingNotification

MAX_ITEMS_PER_NOTIFICATION: Final = 1000
"""Maximum entities, or registrations, in one notification that is composed when it is sent."""
MAX_CHANGES_PER_NOTIFICATION: Final = WINDOW
"""Maximum changes of one request in one notification: as many as are in memory."""
MAX_BYTES_PER_NOTIFICATION: Final = 1024 * 1024
"""Size from which on a notification takes no more changes of its request."""


def first_together(queue: Iterable[PendingNotification]) -> list[PendingNotification]:
    """Return the first notification, and those after it that belong into the same message.

    They are of the same request, with the same headers, and of different entities.
    """
    notices: list[PendingNotification] = []
    entities, size = set[str](), 0
    for notice in islice(queue, MAX_CHANGES_PER_NOTIFICATION):
        if notices and (
            (notice.at, notice.headers) != (notices[0].at, notices[0].headers)
            or notice.entity in entities
            or size + notice.size > MAX_BYTES_PER_NOTIFICATION
        ):
            break
        notices.append(notice)
        entities.add(notice.entity)
        size += notice.size
    return notices


def combined(bodies: Sequence[bytes]) -> bytes:
    """Return one notification with the data of all; its other members are those of the first."""
    if len(bodies) == 1:
        return bodies[0]
    message: dict[str, Any] = orjson.loads(bodies[0])
    data = _list_of(message)
    for body in bodies[1:]:
        data += _list_of(orjson.loads(body))
    return orjson.dumps(message)


def _list_of(message: dict[str, Any]) -> list[Any]:
    """Return the entities of a notification, which are the features of a collection in GeoJSON."""
    data = message["data"]
    entities: list[Any] = data["features"] if isinstance(data, dict) else data
    return entities
