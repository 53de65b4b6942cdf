"""Gloves: the gesture controller's view of each, streamed while a page is open."""

import asyncio
from contextlib import suppress
from typing import Any, Final
from urllib.parse import quote

import orjson
from websockets.exceptions import WebSocketException

from handover.retry import Backoff
from webui.settings import CONTROLLER
from webui.sources.on_demand import OnDemandSource, SourceContext, open_socket

POLL_INTERVAL_S: Final = 1.0
INITIAL_RETRY_S, MAX_RETRY_S = 0.2, 2.0


class Gloves(OnDemandSource):
    """Publishes every glove of the controller."""

    service, family = CONTROLLER, "gloves"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._streams: dict[str, asyncio.Task[None]] = {}
        self._streaming: set[str] = set()

    async def run(self) -> None:
        """Poll the list of gloves and stream each, while a page is open."""
        try:
            while True:
                await self._viewers.wait_until(lambda: bool(self._viewers))
                while self._viewers:
                    await self.refresh()
                    await self._viewers.wait_until(lambda: not self._viewers, POLL_INTERVAL_S)
                await self._stream_only(set())
        finally:
            await self._stream_only(set())

    async def refresh(self) -> None:
        """Fetch the gloves and publish those that are not streamed."""
        views = await self._fetch()
        if views is None:
            return
        for view in views:
            if view["glove"] not in self._streaming:
                self._publish(view)
        names = {str(view["glove"]) for view in views}
        for topic in self._state.topics_of("glove"):
            if topic.partition("/")[2] not in names:
                self._state.remove(topic)
        if self._viewers:
            await self._stream_only(names)

    async def _stream_only(self, names: set[str]) -> None:
        left = [self._streams.pop(name) for name in self._streams.keys() - names]
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)
        for name in names - self._streams.keys():
            self._streams[name] = asyncio.create_task(self._stream(name))

    async def _stream(self, name: str) -> None:
        url = f"ws{self._url.removeprefix('http')}/gloves/{quote(name, safe='')}/live"
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            with suppress(OSError, TimeoutError, WebSocketException):
                async with open_socket(url) as socket:
                    async for text in socket:
                        self._publish(orjson.loads(text))
                        self._streaming.add(name)
                        backoff.reset()
            self._streaming.discard(name)
            await backoff.wait()

    def _publish(self, view: dict[str, Any]) -> None:
        self._state.publish(f"glove/{view['glove']}", view)
