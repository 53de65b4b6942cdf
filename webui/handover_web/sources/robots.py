"""Robots: the trajectory tool's view of each, and the joints as a stream for pages that draw them."""

from typing import Final
from urllib.parse import quote

from handover.service_addresses import TRAJECTORY
from handover_web.sources.on_demand import OnDemandSource, SourceContext, Streams

BUSY_POLL_INTERVAL_S: Final = 0.2
IDLE_POLL_INTERVAL_S: Final = 0.5
JOINTS_HZ: Final = 30


class Robots(OnDemandSource):
    """Polls the robots while a page is open: five times a second while one executes a Task, else twice."""

    service, family = TRAJECTORY, "robots"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._streams = Streams(
            lambda name: self._socket_url(f"/robots/{quote(name, safe='')}/joint_states?hz={JOINTS_HZ}"),
            lambda name, joints: self._state.publish(f"robot/{name}/joints", joints, self._device(name)),
            access=context.access,
            ca_files=context.settings.ca_files,
        )

    async def run(self) -> None:
        """Poll the robots, and stream the joints that pages subscribe to."""
        async with self._streams:
            while True:
                await self._viewers.wait_until(lambda: bool(self._viewers))
                while self._viewers:
                    pause_s = BUSY_POLL_INTERVAL_S if await self._poll() else IDLE_POLL_INTERVAL_S
                    await self._viewers.wait_until(self._must_update_streams, pause_s)
                    await self._update_streams()
                await self._update_streams()

    async def refresh(self) -> None:
        """Fetch the robots and publish them."""
        await self._poll()

    async def _poll(self) -> bool:
        """Fetch and publish the robots; return whether one executes a Task."""
        views = await self._fetch()
        if views is None:
            return False
        for view in views:
            self._state.publish(f"robot/{view['id']}", view, self._device(view["id"]))
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
        return not self._viewers or self._subscribed() != self._streams.names

    async def _update_streams(self) -> None:
        subscribed = self._subscribed()
        ended = self._streams.names - subscribed
        await self._streams.follow(subscribed)
        for name in ended:
            self._state.remove(f"robot/{name}/joints")
