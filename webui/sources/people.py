"""People: a revision of the controller's list, so that every open People page shows the same.

A page asks the controller itself; this source only says when to ask again. It looks at once when something
was written through this server, and every few seconds for what was written elsewhere, while a page wants it.
"""

import asyncio
import hashlib
from typing import Final

import orjson

from webui.settings import CONTROLLER
from webui.sources.looked_at import LookedAt, Lookout

TOPIC: Final = "people"
LOOK_EVERY_S: Final = 3.0


class People(LookedAt):
    """Publishes a revision of the people, their gestures and who wears what, while a page wants it."""

    service, family = CONTROLLER, "people"

    def __init__(self, lookout: Lookout) -> None:
        super().__init__(lookout)
        self._written = asyncio.Event()

    def written(self, service: str) -> None:
        """Look at once: something was written to `service`."""
        if service == self.service:
            self._written.set()

    async def follow(self) -> None:
        """Look again and again while a page wants to know."""
        while True:
            await self._audience.until(lambda: self._audience.wants(TOPIC))
            self._written.clear()
            await self.look()
            try:
                async with asyncio.timeout(LOOK_EVERY_S):
                    await self._written.wait()
            except TimeoutError:
                continue

    async def look(self) -> None:
        """Ask for the people and publish the digest of the answer."""
        if self._audience.wants(TOPIC) and (views := await self._ask()) is not None:
            digest = hashlib.sha256(orjson.dumps(views)).hexdigest()[:16]
            self._world.tell(TOPIC, {"revision": digest})
