"""Robots: the trajectory tool's view of each, and the joints as a stream for pages that draw them."""

import asyncio
from contextlib import suppress
from typing import Final
from urllib.parse import quote

import orjson
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from webui.settings import TRAJECTORY
from webui.sources.looked_at import PATIENCE_S, LookedAt, Lookout

AT_WORK_S: Final = 0.2
AT_REST_S: Final = 0.5
JOINTS_HZ: Final = 30
RETRY_S: Final = 0.5


class Robots(LookedAt):
    """Looks at the robots while somebody looks: five times a second while one works, else less often."""

    service, family = TRAJECTORY, "robots"

    def __init__(self, lookout: Lookout) -> None:
        super().__init__(lookout)
        self._streams: dict[str, asyncio.Task[None]] = {}

    async def follow(self) -> None:
        """Follow the robots while somebody looks."""
        try:
            while True:
                await self._audience.until(lambda: self._audience.looks)
                while self._audience.looks:
                    pause_s = AT_WORK_S if await self._look() else AT_REST_S
                    await self._audience.until(self._streams_are_wrong, pause_s)
                    await self._stream_what_is_wanted()
                await self._stream_what_is_wanted()
        finally:
            await self._stream_only(set())

    async def look(self) -> None:
        """Ask how the robots are."""
        await self._look()

    async def _look(self) -> bool:
        """Ask how the robots are; return whether one works."""
        views = await self._ask()
        if views is None:
            return False
        for view in views:
            self._world.tell(f"robot/{view['id']}", view)
        names = {f"robot/{view['id']}" for view in views}
        for topic in self._world.names("robot"):
            if topic.removesuffix("/joints") not in names:
                self._world.forget(topic)
        return any(view["task"] is not None for view in views)

    def _wanted(self) -> set[str]:
        robots = {
            topic.partition("/")[2] for topic in self._world.names("robot") if not topic.endswith("/joints")
        }
        return {name for name in robots if self._audience.wants(f"robot/{name}/joints")}

    def _streams_are_wrong(self) -> bool:
        return not self._audience.looks or self._wanted() != self._streams.keys()

    async def _stream_what_is_wanted(self) -> None:
        await self._stream_only(self._wanted())

    async def _stream_only(self, names: set[str]) -> None:
        for name in self._streams.keys() - names:
            chore = self._streams.pop(name)
            chore.cancel()
            await asyncio.wait({chore})
            self._world.forget(f"robot/{name}/joints")
        for name in names - self._streams.keys():
            self._streams[name] = asyncio.create_task(self._stream(name))

    async def _stream(self, name: str) -> None:
        url = f"ws{self._url.removeprefix('http')}/robots/{quote(name, safe='')}/joint_states?hz={JOINTS_HZ}"
        while True:
            with suppress(OSError, TimeoutError, WebSocketException):
                async with connect(url, proxy=None, open_timeout=PATIENCE_S, compression=None) as link:
                    async for said in link:
                        self._world.tell(f"robot/{name}/joints", orjson.loads(said))
            await asyncio.sleep(RETRY_S)
