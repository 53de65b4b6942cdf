"""Robots: the trajectory tool's view of each, and the joints as a stream for pages that draw them."""

import asyncio
from contextlib import suppress
from typing import Final
from urllib.parse import quote

import orjson
from websockets.exceptions import WebSocketException

from webui.settings import TRAJECTORY
from webui.sources.on_demand import OnDemandSource, SourceContext, open_socket

BUSY_POLL_INTERVAL_S: Final = 0.2
IDLE_POLL_INTERVAL_S: Final = 0.5
JOINTS_HZ: Final = 30
RETRY_S: Final = 0.5


class Robots(OnDemandSource):
    """Polls the robots while a page is open: five times a second while one executes a Task, else twice."""

    service, family = TRAJECTORY, "robots"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._streams: dict[str, asyncio.Task[None]] = {}

    async def run(self) -> None:
        """Poll the robots, and stream the joints that pages subscribe to."""
        try:
            while True:
                await self._viewers.wait_until(lambda: bool(self._viewers))
                while self._viewers:
                    pause_s = BUSY_POLL_INTERVAL_S if await self._poll() else IDLE_POLL_INTERVAL_S
                    await self._viewers.wait_until(self._must_update_streams, pause_s)
                    await self._update_streams()
                await self._update_streams()
        finally:
            await self._stream_only(set())

    async def refresh(self) -> None:
        """Fetch the robots and publish them."""
        await self._poll()

    async def _poll(self) -> bool:
        """Fetch and publish the robots; return whether one executes a Task."""
        views = await self._fetch()
        if views is None:
            return False
        for view in views:
            self._state.publish(f"robot/{view['id']}", view)
        names = {f"robot/{view['id']}" for view in views}
        for topic in self._state.topics_of("robot"):
            if topic.removesuffix("/joints") not in names:
                self._state.remove(topic)
        return any(view["task"] is not None for view in views)

    def _subscribed(self) -> set[str]:
        robots = {
            topic.partition("/")[2]
            for topic in self._state.topics_of("robot")
            if not topic.endswith("/joints")
        }
        return {name for name in robots if self._viewers.is_subscribed(f"robot/{name}/joints")}

    def _must_update_streams(self) -> bool:
        return not self._viewers or self._subscribed() != self._streams.keys()

    async def _update_streams(self) -> None:
        await self._stream_only(self._subscribed())

    async def _stream_only(self, names: set[str]) -> None:
        for name in self._streams.keys() - names:
            task = self._streams.pop(name)
            task.cancel()
            await asyncio.wait({task})
            self._state.remove(f"robot/{name}/joints")
        for name in names - self._streams.keys():
            self._streams[name] = asyncio.create_task(self._stream(name))

    async def _stream(self, name: str) -> None:
        url = f"ws{self._url.removeprefix('http')}/robots/{quote(name, safe='')}/joint_states?hz={JOINTS_HZ}"
        while True:
            with suppress(OSError, TimeoutError, WebSocketException):
                async with open_socket(url) as socket:
                    async for text in socket:
                        self._state.publish(f"robot/{name}/joints", orjson.loads(text))
            await asyncio.sleep(RETRY_S)
