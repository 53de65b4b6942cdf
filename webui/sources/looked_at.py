"""What is looked at only while somebody looks: a family of things that one service shows as a list."""

import asyncio
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, Final

import httpx

from handover.telemetry import get_logger
from webui.audience import Audience
from webui.settings import WebuiSettings
from webui.sources.services import Services
from webui.sources.source import Source
from webui.world import World

log = get_logger(__name__)

PATIENCE_S: Final = 3.0

View = dict[str, Any]


@dataclass(frozen=True)
class Lookout:
    """Where one looks from: how services are asked, who looks, and whom to tell."""

    settings: WebuiSettings
    http: httpx.AsyncClient
    world: World
    audience: Audience
    services: Services


class LookedAt(Source):
    """The things `family` that `service` lists; looked at once before a page is first told of them."""

    service: str
    family: str

    def __init__(self, lookout: Lookout) -> None:
        self._http = lookout.http
        self._url = lookout.settings.service_urls[self.service]
        self._world = lookout.world
        self._audience = lookout.audience
        self._services = lookout.services
        lookout.audience.before_first_look(self.look)

    @abstractmethod
    async def look(self) -> None:
        """Ask which there are, and how they are."""

    async def _ask(self) -> list[View] | None:
        """Return how they are; None, with the service looked at, if it does not say."""
        try:
            answer = await self._http.get(f"{self._url}/{self.family}", timeout=PATIENCE_S)
            views: list[View] = answer.raise_for_status().json()
        except (httpx.HTTPError, asyncio.IncompleteReadError) as error:
            log.debug("cannot ask", about=self.family, error=str(error))
            self._services.look_now()
            return None
        return views
