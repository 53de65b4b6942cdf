"""People: a revision of the controller's list, so that all open People pages show the same.

The page fetches the list from the controller; this source publishes when to fetch it again. It checks after
each write through this server, and every `POLL_INTERVAL_S` for other writes, while a page subscribes.
"""

import asyncio
import hashlib
from typing import Final

import orjson

from handover.service_addresses import GESTURE_CONTROLLER
from handover_web.sources.on_demand import OnDemandSource, SourceContext

TOPIC: Final = "people"
POLL_INTERVAL_S: Final = 3.0


class People(OnDemandSource):
    """Publishes a digest of the people, their gestures and their gloves, while a page subscribes."""

    service, family = GESTURE_CONTROLLER, "people"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._write_event = asyncio.Event()

    def on_write(self, service: str) -> None:
        """Check now: a client changed something in `service`."""
        if service == self.service:
            self._write_event.set()

    async def run(self) -> None:
        """Poll while a page subscribes."""
        while True:
            await self._viewers.wait_until(lambda: self._viewers.is_subscribed(TOPIC))
            self._write_event.clear()
            await self.refresh()
            try:
                async with asyncio.timeout(POLL_INTERVAL_S):
                    await self._write_event.wait()
            except TimeoutError:
                continue

    async def refresh(self) -> None:
        """Fetch the people and publish the digest of the response."""
        if self._viewers.is_subscribed(TOPIC) and (views := await self._fetch()) is not None:
            digest = hashlib.sha256(orjson.dumps(views)).hexdigest()[:16]
            self._state.publish(TOPIC, {"revision": digest})
