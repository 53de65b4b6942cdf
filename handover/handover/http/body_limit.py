"""Body limit: a request body that is too large is refused before it is read into memory and parsed.

A JSON body that has values which no other part can store or send (`validation.json_fault`) is refused, too.

Bodies are parsed and validated on the event loop. Invalid JSON costs most, since each fault is described: a
second for each MiB. So the default limit of a route is small.
"""

from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Final, TypeVar

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import Message

from handover.formats.validation import json_fault

DEFAULT_MAX_BODY_BYTES: Final = 64 * 1024
MAX_NOTIFICATION_BYTES: Final = 32 * 1024 * 1024
"""A notification may have many entities; orjson parses it, and it is not validated."""
_NOTIFICATIONS: Final = "/notifications"

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


def max_body(max_bytes: int) -> Callable[[Endpoint], Endpoint]:
    """Set the maximum size of the body of a route; a decorator below that of the route."""

    def marked(endpoint: Endpoint) -> Endpoint:
        endpoint.max_body_bytes = max_bytes  # type: ignore[attr-defined]
        return endpoint

    return marked


def limit_of(endpoint: Callable[..., Any], path: str) -> int:
    """Return how many bytes the body of a request for `endpoint` at `path` may have."""
    usual = MAX_NOTIFICATION_BYTES if path.startswith(_NOTIFICATIONS) else DEFAULT_MAX_BODY_BYTES
    return int(getattr(endpoint, "max_body_bytes", usual))


def limited(request: Request, max_bytes: int) -> Request:
    """Return `request` such that reading a body of more than `max_bytes` raises 413.

    Raises it at once where the request says its length.
    """
    stated = request.headers.get("content-length", "")
    if stated.isdecimal() and int(stated) > max_bytes:
        raise _too_large(max_bytes)
    received = 0

    async def receive() -> Message:
        nonlocal received
        message = await request.receive()
        received += len(message.get("body", b""))
        if received > max_bytes:
            raise _too_large(max_bytes)
        return message

    return _JsonRequest(request.scope, receive)


class _JsonRequest(Request):
    async def json(self) -> Any:
        document = await super().json()
        if (fault := json_fault(await self.body(), document)) is not None:
            raise HTTPException(HTTPStatus.UNPROCESSABLE_ENTITY, fault)
        return document


def _too_large(max_bytes: int) -> HTTPException:
    return HTTPException(
        HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the body has more than {max_bytes} bytes; send less at once"
    )
