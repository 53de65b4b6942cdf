"""Registered devices: the device gateway's view of each, with its latest values, while a page shows them."""

import asyncio
from typing import Final

from handover.service_addresses import DEVICE_GATEWAY
from handover_web.live.live_state import REGISTERED_DEVICE, REGISTERED_DEVICES
from handover_web.sources.on_demand import OnDemandSource, SourceContext, View

POLL_INTERVAL_S: Final = 1.0
PAGE_SIZE: Final = 1000


class RegisteredDevices(OnDemandSource):
    """Publishes each registered device once a second while a page subscribes.

    While the gateway does not answer, all values are stale.
    """

    service, family = DEVICE_GATEWAY, "devices"

    def __init__(self, context: SourceContext) -> None:
        super().__init__(context)
        self._write_event = asyncio.Event()
        self._views: dict[str, View] = {}

    def on_write(self, service: str) -> None:
        """Fetch now: a client changed something in `service`."""
        if service == self.service:
            self._write_event.set()

    async def run(self) -> None:
        """Poll while a page subscribes; forget the devices afterwards, so that no old value is shown."""
        while True:
            await self._viewers.wait_until(self._is_wanted)
            while self._is_wanted():
                self._write_event.clear()
                await self.refresh()
                try:
                    async with asyncio.timeout(POLL_INTERVAL_S):
                        await self._write_event.wait()
                except TimeoutError:
                    continue
            self._publish({})
            self._state.remove(REGISTERED_DEVICES)

    async def refresh(self) -> None:
        """Fetch the devices and publish them."""
        if not self._is_wanted():
            return
        views: dict[str, View] = {}
        while (page := await self._fetch({"limit": PAGE_SIZE, "after": max(views, default="")})) is not None:
            views |= {view["name"]: view for view in page}
            if len(page) < PAGE_SIZE:
                break
        self._publish(_outdated(self._views) if page is None else views)
        self._state.publish(REGISTERED_DEVICES, {"isCurrent": page is not None})

    def _is_wanted(self) -> bool:
        return self._viewers.is_subscribed(REGISTERED_DEVICES)

    def _publish(self, views: dict[str, View]) -> None:
        for name in self._views.keys() - views.keys():
            self._state.remove(f"{REGISTERED_DEVICE}{self._views[name]['entity']}")
        for view in views.values():
            self._state.publish(f"{REGISTERED_DEVICE}{view['entity']}", view)
        self._views = views


def _outdated(views: dict[str, View]) -> dict[str, View]:
    return {
        name: view | {"values": {key: value | {"stale": True} for key, value in view["values"].items()}}
        for name, view in views.items()
    }
