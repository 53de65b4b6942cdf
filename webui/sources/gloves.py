"""Gloves: the gesture controller's view of each, live as the hand moves, while somebody looks."""

import asyncio
from contextlib import suppress
from typing import Any, Final
from urllib.parse import quote

import orjson
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from handover.retry import Backoff
from webui.settings import CONTROLLER
from webui.sources.looked_at import PATIENCE_S, LookedAt, Lookout

LOOK_EVERY_S: Final = 1.0
INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 2.0


class Gloves(LookedAt):
    """Follows every glove that the controller knows."""

    service, family = CONTROLLER, "gloves"

    def __init__(self, lookout: Lookout) -> None:
        super().__init__(lookout)
        self._following: dict[str, asyncio.Task[None]] = {}
        self._live: set[str] = set()

    async def follow(self) -> None:
        """Follow the gloves while somebody looks."""
        try:
            while True:
                await self._audience.until(lambda: self._audience.looks)
                while self._audience.looks:
                    await self.look()
                    await self._audience.until(lambda: not self._audience.looks, LOOK_EVERY_S)
                await self._follow_only(set())
        finally:
            await self._follow_only(set())

    async def look(self) -> None:
        """Ask which gloves there are, and how they are."""
        views = await self._ask()
        if views is None:
            return
        for view in views:
            if view["glove"] not in self._live:
                self._tell(view)
        names = {str(view["glove"]) for view in views}
        for topic in self._world.names("glove"):
            if topic.partition("/")[2] not in names:
                self._world.forget(topic)
        if self._audience.looks:
            await self._follow_only(names)

    async def _follow_only(self, names: set[str]) -> None:
        left = [self._following.pop(name) for name in self._following.keys() - names]
        for chore in left:
            chore.cancel()
        await asyncio.gather(*left, return_exceptions=True)
        for name in names - self._following.keys():
            self._following[name] = asyncio.create_task(self._follow_one(name))

    async def _follow_one(self, name: str) -> None:
        url = f"ws{self._url.removeprefix('http')}/gloves/{quote(name, safe='')}/live"
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            with suppress(OSError, TimeoutError, WebSocketException):
                async with connect(url, proxy=None, open_timeout=PATIENCE_S, compression=None) as link:
                    async for said in link:
                        self._tell(orjson.loads(said))
                        self._live.add(name)
                        backoff.reset()
            self._live.discard(name)
            await backoff.wait()

    def _tell(self, view: dict[str, Any]) -> None:
        self._world.tell(f"glove/{view['glove']}", view)
