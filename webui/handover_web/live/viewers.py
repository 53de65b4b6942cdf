"""The open pages, and which on-demand topics they subscribe to.

Sources that cost a service something, such as the stream of a glove or of a robot's joints, run only while a
page is open.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from handover_web.live.live_state import Viewer

MAX_INITIAL_REFRESH_S = 1.0
"""How long the first page waits for sources that were idle while no page was open."""

Refresh = Callable[[], Awaitable[None]]


class Viewers:
    """The viewers of all open pages."""

    def __init__(self) -> None:
        self._viewers: set[Viewer] = set()
        self._waiters: set[asyncio.Future[None]] = set()
        self._refreshes: list[Refresh] = []
        self._refreshing: asyncio.Task[None] | None = None

    def __len__(self) -> int:
        return len(self._viewers)

    def __bool__(self) -> bool:
        return bool(self._viewers)

    def is_subscribed(self, topic: str) -> bool:
        """Whether any page subscribes to `topic`."""
        return any(topic in viewer.subscribed for viewer in self._viewers)

    def before_first_page(self, refresh: Refresh) -> None:
        """Call `refresh` when a page opens while no other is open, before its snapshot is sent."""
        self._refreshes.append(refresh)

    async def add(self, viewer: Viewer) -> None:
        """Add `viewer`; return when the sources are refreshed, or after `MAX_INITIAL_REFRESH_S`."""
        if not self._viewers:
            self._refreshing = asyncio.create_task(self._refresh())
        self._viewers.add(viewer)
        self.notify()
        if self._refreshing is not None:
            await asyncio.wait({self._refreshing}, timeout=MAX_INITIAL_REFRESH_S)

    def remove(self, viewer: Viewer) -> None:
        """Remove `viewer`."""
        self._viewers.discard(viewer)
        self.notify()

    def notify(self) -> None:
        """Wake `wait_until`: a page was opened or closed, or its subscriptions changed."""
        for future in self._waiters:
            if not future.done():
                future.set_result(None)
        self._waiters.clear()

    async def wait_until(self, condition: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until `condition` holds, evaluated at each `notify`; return False after `timeout_s`."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while not condition():
                    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
                    self._waiters.add(future)
                    try:
                        await future
                    finally:
                        self._waiters.discard(future)
        return condition()

    async def _refresh(self) -> None:
        await asyncio.gather(*(refresh() for refresh in self._refreshes), return_exceptions=True)
