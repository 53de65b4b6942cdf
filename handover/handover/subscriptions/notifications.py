"""Notifications: receives the notifications of the broker.

A notification is a hint: it may be late, duplicated, lost or forged. Two rules follow.

1. It is accepted only with the key of the subscription (`endpoint.receiverInfo`, which brokers send as an
HTTP
   header), never from a web page (`Origin`), and only as JSON. The key is random, one per service, and stored
   in the data directory, so that a subscription of an earlier run stays valid.
2. A component reads the entity from the broker (`read`) before it changes a Task, a process, a robot or a
   gripper. A notification only names the entities to read.
"""

import asyncio
import hmac
import os
import re
import secrets
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import orjson
from fastapi import Depends, Request
from prometheus_client import Counter

from handover.broker import BrokerClient, BrokerError
from handover.errors import Problem, UsageError
from handover.security.guard import OtherCredential
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

KEY_HEADER: Final = "Handover-Notification-Key"
MEDIA_TYPES: Final = ("application/json", "application/ld+json")
MAX_BYTES: Final = 10 * 1024 * 1024
MAX_IDS_PER_QUERY: Final = 40
"""Entities per query; their ids are in its URL."""

REFUSED = Counter("handover_notifications_refused_total", "Notifications that were refused", ["reason"])

REQUIRES_NOTIFICATION_KEY: Final[Any] = Depends(OtherCredential("the key of the subscription"))
"""The dependency that marks a route for notifications, which `NotificationReceiver.receive` protects."""

_KEY: Final = re.compile(r"^[\x21-\x7e]{16,200}$")


class NotificationReceiver:
    """Receives the notifications of the service `name`, and reads their entities from `broker`."""

    def __init__(self, name: str, settings: Settings, broker: BrokerClient) -> None:
        self._name = name
        self._settings = settings
        self._broker = broker
        self._reads: dict[tuple[str, str | None], _Read] = {}
        self._reading = asyncio.Lock()

    @cached_property
    def key(self) -> str:
        """Return the key of this service. Raises `UsageError` if it cannot be stored."""
        if self._settings.notification_key is not None:
            return self._settings.notification_key.get_secret_value()
        file_name = re.sub(r"[^A-Za-z0-9_.-]", "_", self._name) + ".notification-key"
        return _stored_key(self._settings.data_dir / file_name)

    def require_key(self) -> None:
        """Raise `UsageError` if this service has no key and none can be stored."""
        _ = self.key

    def endpoint(self, uri: str) -> dict[str, Any]:
        """Return the `endpoint` of a subscription whose notifications go to `uri`."""
        return {
            "uri": uri,
            "accept": MEDIA_TYPES[0],
            "receiverInfo": [{"key": KEY_HEADER, "value": self.key}],
        }

    async def receive(self, request: Request) -> list[dict[str, Any]]:
        """Return the entities of the notification `request`.

        Raises `Problem`: 403 without our key or from a web page, 415 for another media type, 413 when it is
        too large, 400 when it cannot be read.
        """
        headers = request.headers
        if "origin" in headers:
            raise _refuse("origin", 403, "notifications come from the broker, never from a web page")
        if not hmac.compare_digest(headers.get(KEY_HEADER, "").encode(), self.key.encode()):
            raise _refuse(
                "key",
                403,
                f"the header {KEY_HEADER} does not have the key of {self._name}; the broker sends the "
                "receiverInfo of the subscription",
            )
        if headers.get("content-type", "").partition(";")[0].strip().lower() not in MEDIA_TYPES:
            raise _refuse("media type", 415, f"a notification is {' or '.join(MEDIA_TYPES)}")
        return _entities_of(await _body(request))

    async def read(
        self, entity_type: str, ids: Iterable[str], *, q: str | None = None
    ) -> list[dict[str, Any]]:
        """Return the present state of the entities `ids` of one type that match `q`.

        Calls during a running query are served by the next one together, so that many notifications cause
        few queries. Raises `BrokerError`.
        """
        requested = frozenset(ids)
        if not requested:
            return []
        selected = entity_type, q
        read = self._reads.setdefault(selected, _Read())
        read.ids |= requested
        async with self._reading:
            if not read.is_done:
                if self._reads.get(selected) is read:
                    del self._reads[selected]
                await read.carry_out(self._broker, entity_type, q)
        if read.error is not None:
            raise read.error
        return [read.found[entity_id] for entity_id in requested if entity_id in read.found]


class _Read:
    """One read of several entities for several callers."""

    def __init__(self) -> None:
        self.ids: frozenset[str] = frozenset()
        self.found: dict[str, dict[str, Any]] = {}
        self.error: BrokerError | None = None
        self.is_done = False

    async def carry_out(self, broker: BrokerClient, entity_type: str, q: str | None) -> None:
        ids = sorted(self.ids)
        try:
            for start in range(0, len(ids), MAX_IDS_PER_QUERY):
                chunk = ids[start : start + MAX_IDS_PER_QUERY]
                for entity in await broker.query(type=entity_type, id=chunk, q=q):
                    self.found[str(entity.get("id"))] = entity
        except BrokerError as error:
            self.error = error
        self.is_done = True


def ids_of(entities: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the ids of the entities with a valid id."""
    return [entity["id"] for entity in entities if isinstance(entity.get("id"), str)]


async def _body(request: Request) -> bytes:
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BYTES:
            raise _refuse("too large", 413, f"a notification holds at most {MAX_BYTES} bytes")
    return bytes(body)


def _entities_of(body: bytes) -> list[dict[str, Any]]:
    try:
        notification = orjson.loads(body)
    except orjson.JSONDecodeError as error:
        raise _refuse("not JSON", 400, f"the body is not JSON: {error}") from None
    data = notification.get("data") if isinstance(notification, dict) else None
    if not isinstance(data, list) or not all(isinstance(entity, dict) for entity in data):
        raise _refuse("no data", 400, 'an NGSI-LD notification is an object with the entities in "data"')
    return data


def _stored_key(file: Path) -> str:
    """Return the key of `file`, after writing a new one if there is none."""
    try:
        with suppress(FileNotFoundError):
            kept = file.read_bytes().decode("ascii", "replace").strip()
            if is_notification_key(kept):
                return kept
            log.warning("the key for notifications is damaged; a new one replaces it", file=str(file))
        key = secrets.token_urlsafe(32)
        file.parent.mkdir(parents=True, exist_ok=True)
        unfinished = file.with_name(f"{file.name}.{os.getpid()}")
        unfinished.unlink(missing_ok=True)
        with open(os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as out:  # noqa: PTH123 - the mode is set at creation
            out.write(key)
            out.flush()
            os.fsync(out.fileno())
        unfinished.replace(file)
    except OSError as error:
        raise UsageError(
            f"the key for notifications cannot be stored in {file}: {error.strerror}; make it writable, "
            "or set the key with HANDOVER_NOTIFICATION_KEY"
        ) from None
    return key


def is_notification_key(text: str) -> bool:
    """Return whether `text` has the form of a key for notifications."""
    return _KEY.match(text) is not None


def _refuse(reason: str, status: int, detail: str) -> Problem:
    REFUSED.labels(reason).inc()
    return Problem(status, "Notification refused", detail)
