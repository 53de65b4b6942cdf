"""On-demand sources: resources that a service lists, refreshed only while a page is open."""

import asyncio
from abc import abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import httpx
from websockets.asyncio.client import connect

from handover.telemetry import get_logger
from webui.live.live_state import LiveState
from webui.live.viewers import Viewers
from webui.settings import WebuiSettings
from webui.sources.services import ServiceMonitor
from webui.sources.source import Source

log = get_logger(__name__)

REQUEST_TIMEOUT_S: Final = 3.0

open_socket: Final = partial(connect, proxy=None, open_timeout=REQUEST_TIMEOUT_S, compression=None)
"""Connect to a WebSocket of a service."""

View = dict[str, Any]


@dataclass(frozen=True)
class SourceContext:
    """What every on-demand source needs."""

    settings: WebuiSettings
    http: httpx.AsyncClient
    state: LiveState
    viewers: Viewers
    services: ServiceMonitor


class OnDemandSource(Source):
    """The resources at `/{family}` of `service`, refreshed before the first page receives its snapshot."""

    service: str
    family: str

    def __init__(self, context: SourceContext) -> None:
        self._http = context.http
        self._url = context.settings.service_urls[self.service]
        self._state = context.state
        self._viewers = context.viewers
        self._services = context.services
        context.viewers.before_first_page(self.refresh)

    @abstractmethod
    async def refresh(self) -> None:
        """Fetch the resources and publish them."""

    async def _fetch(self) -> list[View] | None:
        """Return the resources; on an error return None and have the service checked."""
        try:
            response = await self._http.get(f"{self._url}/{self.family}", timeout=REQUEST_TIMEOUT_S)
            views: list[View] = response.raise_for_status().json()
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            log.debug("request failed", resource=self.family, error=str(error))
            self._services.check_now()
            return None
        return views
