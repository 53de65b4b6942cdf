"""The one door for the browser: the page, everything live over one WebSocket, and REST passed through."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any
from urllib.parse import urlsplit

import httpx
from fastapi import FastAPI, Query, Request, Response, WebSocket
from pydantic import BaseModel, ConfigDict, Field
from starlette.types import ASGIApp

from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover.service import create_app
from webui.audience import Audience
from webui.doors import METHODS, Doors
from webui.events import MOST_AT_ONCE, EventLog
from webui.gate import Gate
from webui.live import Live
from webui.page import Page
from webui.settings import WebuiSettings
from webui.simulated_operator import FIRST_GLOVE, SimulatedOperator
from webui.sources.alerts import Alerts
from webui.sources.devices import Devices
from webui.sources.entities import Entities
from webui.sources.gloves import Gloves
from webui.sources.looked_at import Lookout
from webui.sources.processes import ProcessEntities, Processes
from webui.sources.robots import Robots
from webui.sources.services import Services
from webui.sources.source import followed
from webui.sources.tasks import Tasks
from webui.world import World


class Acknowledgement(BaseModel):
    """Who says that they know of an alert."""

    model_config = ConfigDict(extra="forbid")

    by: Annotated[str, Field(min_length=1, max_length=100, pattern=r"\S")]


class Employment(BaseModel):
    """Which glove the simulated operator puts on."""

    model_config = ConfigDict(extra="forbid")

    glove: str = FIRST_GLOVE


class Screen:
    """What the routes share: the world, who looks at it, and where it comes from."""

    def __init__(self, settings: WebuiSettings, page: Page) -> None:
        self.page = page
        self.world = World()
        self.audience = Audience()
        self.events = EventLog(connect(settings.database("webui")), self.world.happened)
        self.broker = BrokerClient(settings)
        urls = settings.service_urls
        self.doors = Doors(urls)
        self.http = http = httpx.AsyncClient(trust_env=False)
        self.operator = SimulatedOperator(settings, http, self.world, self.events)
        self.live = Live(self.world, self.audience)
        services = Services(urls, http, self.broker, self.world, self.events)
        devices = Devices(self.world, self.events, services)
        processes = Processes(settings, http, self.world, self.events, services)
        tasks = Tasks(self.events, devices, services, processes.look_at)
        self.alerts = Alerts(self.world, self.events, self.broker)
        kinds = (devices, tasks, ProcessEntities(processes), self.alerts)
        self.entities = Entities(settings, self.broker, kinds, services)
        lookout = Lookout(settings, http, self.world, self.audience, services)
        self._sources = (services, self.entities, processes, Gloves(lookout), Robots(lookout))
        self.world.tell("cell", cell_of(settings))

    @asynccontextmanager
    async def at_work(self, _: FastAPI) -> AsyncIterator[None]:
        """Follow everything until the server ends."""
        async with (
            self.broker,
            self.http,
            self.doors,
            self.events,
            self.operator,
            followed(self._sources),
        ):
            yield

    async def check_page(self) -> None:
        """Return if there is a page to show; the services behind it may well be away."""
        if not self.page.is_built:
            raise Problem(503, "Not built", "the page is not built; run make setup")


def make_app(settings: WebuiSettings, page: Page | None = None) -> ASGIApp:
    """Return the application; raises `UsageError` when it could not work as it is set."""
    screen = Screen(settings, page or Page())
    app = create_app(
        "Web UI", description=__doc__ or "", lifespan=screen.at_work, checks={"page": screen.check_page}
    )
    screen.entities.mount(app)
    _add_own(app, screen)
    _add_doors(app, screen)
    _add_page(app, screen)
    own_name = urlsplit(settings.own_url).hostname or settings.host
    return Gate(app, (own_name, settings.host, *settings.webui_hosts))


def _add_own(app: FastAPI, screen: Screen) -> None:
    @app.websocket("/api/live")
    async def live(page: WebSocket) -> None:
        await screen.live.show(page)

    @app.get("/api/events", tags=["events"])
    async def events(
        after: Annotated[int | None, Query(ge=0)] = None,
        before: Annotated[int | None, Query(ge=0)] = None,
        limit: Annotated[int, Query(ge=1, le=MOST_AT_ONCE)] = 200,
    ) -> list[dict[str, Any]]:
        """Return events, oldest first: the first after a `seq`, the last before one, or the newest."""
        if after is not None:
            return await screen.events.after(after, limit)
        return await screen.events.before(before, limit)

    @app.post("/api/alerts/{alert}/acknowledge", tags=["alerts"])
    async def acknowledge(alert: str, said: Acknowledgement) -> dict[str, Any]:
        """Write down who knows of an alert: 404 if there is none, 409 if somebody has acknowledged it."""
        return await screen.alerts.acknowledge(alert, said.by.strip())

    @app.post("/api/operator", status_code=201, tags=["operator"])
    async def start_operator(employment: Employment) -> dict[str, Any]:
        """Start the simulated operator: 409 if it runs, or if somebody wears the glove."""
        return await screen.operator.start(employment.glove)

    @app.delete("/api/operator", tags=["operator"])
    async def stop_operator() -> dict[str, Any]:
        """Stop the simulated operator; nothing happens if it does not run."""
        return await screen.operator.stop()


def _add_doors(app: FastAPI, screen: Screen) -> None:
    @app.api_route("/api/{service}/{path:path}", methods=list(METHODS), include_in_schema=False)
    async def pass_through(service: str, path: str, request: Request) -> Response:  # noqa: ARG001
        return await screen.doors.pass_through(service, _still_quoted(request, service), request)

    @app.api_route("/api/{rest:path}", methods=list(METHODS), include_in_schema=False)
    async def nothing_there(rest: str) -> Response:
        raise Problem(404, "Not found", f"there is nothing at /api/{rest}")


def _add_page(app: FastAPI, screen: Screen) -> None:
    @app.api_route("/{address:path}", methods=["GET", "HEAD"], include_in_schema=False)
    async def page(address: str, request: Request) -> Response:
        return await screen.page.answer(address, request.headers)


def _still_quoted(request: Request, service: str) -> str:
    """Return the path behind the service's door as it was sent: a quoted slash is no slash."""
    raw = bytes(request.scope.get("raw_path") or request.scope["path"].encode())
    return raw.partition(b"?")[0].decode("latin-1").removeprefix(f"/api/{service}/")


def _version() -> str:
    try:
        return version("handover")
    except PackageNotFoundError:
        return "0"


def cell_of(settings: WebuiSettings) -> dict[str, str]:
    """Return what never changes while it runs: the cell's name, the version, the place of the real stop."""
    cell = {"factory": settings.factory, "version": _version()}
    return {**cell, "emergencyStop": settings.emergency_stop} if settings.emergency_stop else cell
