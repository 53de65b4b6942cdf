"""Gloves: the gesture controller's view of each, streamed while a page is open."""

from typing import Any, Final
from urllib.parse import quote

from handover.service_addresses import GESTURE_CONTROLLER
from handover_web.sources.on_demand import OnDemandSource, SourceContext, Streams

POLL_INTERVAL_S: Final = 1.0


class Gloves(OnDemandSource):
    """Publishes every glove of the controller."""

    service, family = GESTURE_CONTROLLER, "gloves"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._streaming: set[str] = set()
        self._streams = Streams(
            lambda name: self._socket_url(f"/gloves/{quote(name, safe='')}/live"),
            self._publish_streamed,
            on_end=self._streaming.discard,
            access=context.access,
            ca_files=context.settings.ca_files,
        )

    async def run(self) -> None:
        """Poll the list of gloves and stream each, while a page is open."""
        async with self._streams:
            while True:
                await self._viewers.wait_until(lambda: bool(self._viewers))
                while self._viewers:
                    await self.refresh()
                    await self._viewers.wait_until(lambda: not self._viewers, POLL_INTERVAL_S)
                await self._streams.follow(set())

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
            await self._streams.follow(names)

    def _publish_streamed(self, name: str, view: dict[str, Any]) -> None:
        self._publish(view)
        self._streaming.add(name)

    def _publish(self, view: dict[str, Any]) -> None:
        wearer = view.get("person")
        worn = () if wearer is None else (self._settings.entity_id("Person", wearer),)
        self._state.publish(f"glove/{view['glove']}", view, (*self._device(view["glove"]), *worn))
