"""Markers from Tasks: each new status of a Task that involves a person who is being recorded.

The broker notifies of Tasks only while something is recorded. A gesture that answers a Task is named in the
marker of its status. A notification is a hint: the Task is read from the broker before it is marked.
"""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import Any, Final

from fastapi import FastAPI, Request, Response

from handover.broker import BrokerClient, BrokerError
from handover.broker.latest_value_writer import LatestValueWriter
from handover.runtime.retry import with_jitter
from handover.service_addresses import HUMAN_STATE
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY, NotificationReceiver, ids_of
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.telemetry import get_logger
from handover_body.formats.json_messages import Marker
from handover_body.recording.recordings import Recordings
from handover_body.settings import HumanStateSettings
from handover_datamodels import Task

log = get_logger(__name__)

NAME: Final = HUMAN_STATE
PATH: Final = "/notifications"
MARKER: Final = "task"
MAX_REMEMBERED: Final = 10_000


class TaskMarkers:
    """Subscribes to Tasks while something is recorded, and marks what changes."""

    def __init__(
        self,
        settings: HumanStateSettings,
        recordings: Recordings,
        broker: BrokerClient,
        writer: LatestValueWriter,
    ) -> None:
        self._settings = settings
        self._recordings = recordings
        self._broker = broker
        self._writer = writer
        self._receiver = NotificationReceiver(NAME, settings, broker)
        self._subscriptions = OwnSubscriptions(NAME, settings, broker)
        self._seen: OrderedDict[tuple[str, str], str] = OrderedDict()
        """The status that was marked, by person and Task."""
        self._id = settings.entity_id("Subscription", f"{NAME}-tasks")

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications."""

        @app.post(PATH, status_code=204, tags=["notifications"], dependencies=[REQUIRES_NOTIFICATION_KEY])
        async def notify(request: Request) -> Response:
            """Read the Tasks of a notification from the broker, and mark them."""
            await self._read(ids_of(await self._receiver.receive(request)))
            return Response(status_code=204)

    def require_key(self) -> None:
        """Raise `UsageError` if the key of notifications cannot be stored."""
        self._receiver.require_key()

    def apply(self) -> None:
        """Subscribe or unsubscribe, as soon as the broker answers."""
        self._writer.put(self._id, self._synchronize)

    async def run(self) -> None:
        """Check the subscription regularly until cancelled."""
        while True:
            await asyncio.sleep(with_jitter(self._settings.reconcile_s))
            if self._recordings.recorded():
                self.apply()

    async def _synchronize(self) -> None:
        if self._recordings.recorded():
            await self._subscriptions.keep(self._subscription())
        else:
            self._seen.clear()
            await self._subscriptions.drop(self._id)

    def _subscription(self) -> dict[str, Any]:
        return {
            "id": self._id,
            "type": "Subscription",
            "description": "Tasks of persons who are being recorded",
            "entities": [{"type": Task.ngsi_type()}],
            "watchedAttributes": ["status"],
            "notification": {
                "format": "normalized",
                "endpoint": self._receiver.endpoint(f"{self._settings.human_state}{PATH}"),
            },
        }

    async def _read(self, identifiers: Iterable[str]) -> None:
        if not self._recordings.recorded():
            return
        try:
            entities = await self._receiver.read(Task.ngsi_type(), identifiers)
        except BrokerError as error:
            log.warning("tasks not marked", error=str(error))
            return
        for entity in entities:
            self._mark(entity)

    def _mark(self, entity: Mapping[str, Any]) -> None:
        try:
            task = Task.from_ngsild(entity)
        except ValueError as error:
            log.warning("task not marked", task=str(entity.get("id"))[:200], error=str(error)[:300])
            return
        status = str(task.status.value)
        involved = {link.object for link in task.involves or ()}
        for person in self._recordings.recorded():
            key = person, task.id
            if self._settings.entity_id("Person", person) not in involved or self._seen.get(key) == status:
                continue
            self._seen[key] = status
            while len(self._seen) > MAX_REMEMBERED:
                self._seen.popitem(last=False)
            name = task.id if task.name is None else str(task.name.value)
            text = f"{name[:200]}: {status}{_gesture_of(task)}"
            self._recordings.mark_person(person, Marker(time.time(), MARKER, text))


def _gesture_of(task: Task) -> str:
    """Return by which gesture a Task has ended, as the end of a text; empty for another way."""
    output = None if task.output_parameters is None else task.output_parameters.value
    if not isinstance(output, Mapping) or output.get("by") != "gesture":
        return ""
    return f" by the gesture {str(output.get('gesture'))[:100]}"
