"""On-demand sources: resources that a service lists, refreshed only while a page is open."""

import asyncio
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

import httpx
import orjson
from websockets.asyncio.client import connect
from websockets.exceptions import WebSocketException

from handover.errors import UsageError
from handover.network.tls_trust import tls_of
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.service_access import AccountsUnavailable, ServiceAccess
from handover.telemetry import get_logger
from handover_web.live.live_state import LiveState
from handover_web.live.viewers import Viewers
from handover_web.settings import WebuiSettings
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.source import Source

log = get_logger(__name__)

REQUEST_TIMEOUT_S: Final = 3.0

_connect: Final = partial(connect, proxy=None, open_timeout=REQUEST_TIMEOUT_S, compression=None)

View = dict[str, Any]


@dataclass(frozen=True)
class SourceContext:
    """What every on-demand source needs."""

    settings: WebuiSettings
    http: httpx.AsyncClient
    state: LiveState
    viewers: Viewers
    services: ServiceMonitor
    access: ServiceAccess


class OnDemandSource(Source):
    """The resources at `/{family}` of `service`, refreshed before the first page receives its snapshot."""

    service: str
    family: str

    def __init__(self, context: SourceContext) -> None:
        self._settings = context.settings
        self._http = context.http
        self._url = context.settings.service_urls[self.service]
        self._state = context.state
        self._viewers = context.viewers
        self._services = context.services
        context.viewers.before_first_page(self.refresh)

    @abstractmethod
    async def refresh(self) -> None:
        """Fetch the resources and publish them."""

    def _device(self, name: str) -> tuple[str, ...]:
        """Return the resource of a Device."""
        return (self._settings.entity_id("Device", name),)

    def _socket_url(self, path: str) -> str:
        return f"ws{self._url.removeprefix('http')}{path}"

    async def _fetch(self, query: Mapping[str, str | int] | None = None) -> list[View] | None:
        """Return the resources; on an error return None and have the service checked."""
        url = f"{self._url}/{self.family}"
        try:
            response = await self._http.get(url, params=query, timeout=REQUEST_TIMEOUT_S)
            views: list[View] = response.raise_for_status().json()
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            log.debug("request failed", resource=self.family, error=str(error))
            self._services.check_now()
            return None
        return views


class Streams:
    """One WebSocket for each followed resource, connected again with backoff.

    An asynchronous context manager. `on_message` is called with the name of the resource and each message,
    `on_end` with the name whenever its connection has ended.
    """

    def __init__(
        self,
        url_of: Callable[[str], str],
        on_message: Callable[[str, Any], object],
        on_end: Callable[[str], None] = lambda _: None,
        *,
        access: ServiceAccess,
        ca_files: Sequence[Path] = (),
    ) -> None:
        self._access = access
        self._url_of = url_of
        self._on_message = on_message
        self._on_end = on_end
        self._ca_files = ca_files
        self._background = BackgroundTasks("streams")
        self._tasks: dict[str, asyncio.Task[None]] = {}

    @property
    def names(self) -> Set[str]:
        """Return the names of the followed resources."""
        return self._tasks.keys()

    async def __aenter__(self) -> Self:
        await self._background.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._background.__aexit__()

    async def follow(self, names: Set[str]) -> None:
        """Follow exactly the resources `names`; return when the other streams have ended."""
        ended = [self._tasks[name] for name in self._tasks.keys() - names]
        for task in ended:
            task.cancel()
        if ended:
            await asyncio.wait(ended)
        for name in names - self._tasks.keys():
            task = self._tasks[name] = self._background.start_restarting(self._stream, name)
            task.add_done_callback(partial(self._forget, name))

    def _forget(self, name: str, task: asyncio.Task[None]) -> None:
        if self._tasks.get(name) is task:
            del self._tasks[name]

    async def _stream(self, name: str) -> None:
        try:
            with suppress(OSError, TimeoutError, WebSocketException, AccountsUnavailable, UsageError):
                url, headers = self._url_of(name), await self._access.headers()
                tls = tls_of(url, self._ca_files)
                async with _connect(url, ssl=tls, additional_headers=headers) as socket:
                    async for text in socket:
                        self._on_message(name, orjson.loads(text))
        finally:
            self._on_end(name)
