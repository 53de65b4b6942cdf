"""The one door for the browser: the page, everything live over one WebSocket, and REST passed through."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

import httpx
from fastapi import FastAPI, Query, Request, Response, WebSocket
from pydantic import BaseModel, ConfigDict, Field
from starlette.types import ASGIApp

from handover.body_limit import max_body
from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover.service import ANY_TYPE, accepts, create_app
from handover.storage import storage_check
from webui.audience import Audience
from webui.doors import METHODS, Doors
from webui.events import MAX_SEQ, MOST_AT_ONCE, EventLog
from webui.live import Live
from webui.page import Page
from webui.secure_headers import SecureHeaders
from webui.settings import WebuiSettings
from webui.simulated_operator import FIRST_GLOVE, SimulatedOperator
from webui.sources.alerts import MAX_ALERTS_AT_ONCE, MAX_SHELVING, Alerts
from webui.sources.devices import Devices
from webui.sources.entities import Entities
from webui.sources.gloves import Gloves
from webui.sources.looked_at import Lookout
from webui.sources.people import People
from webui.sources.processes import ProcessEntities, Processes
from webui.sources.robots import Robots
from webui.sources.services import Services
from webui.sources.source import followed
from webui.sources.tasks import Tasks
from webui.world import World

MAX_PASSED_BYTES = 4 * 1024 * 1024
MAX_ALERTS_BYTES = 256 * 1024
"""The ids of `MAX_ALERTS_AT_ONCE` Alerts, of which each may be long."""


class Acknowledgement(BaseModel):
    """Who acknowledges an alert."""

    model_config = ConfigDict(extra="forbid")

    by: Annotated[str, Field(min_length=1, max_length=100, pattern=r"\S")]


Ids = Annotated[
    list[Annotated[str, Field(min_length=1, max_length=2000)]],
    Field(min_length=1, max_length=MAX_ALERTS_AT_ONCE),
]


class ManyAlerts(Acknowledgement):
    """Alerts, and who does something with them."""

    alerts: Ids


class Shelving(ManyAlerts):
    """Alerts to shelve, and for how long."""

    minutes: Annotated[float, Field(gt=0, le=MAX_SHELVING.total_seconds() / 60)]


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
        people = People(lookout)
        self.doors = Doors(urls, people.written)
        followed_closely = (Gloves(lookout), Robots(lookout), people)
        self._sources = (services, self.entities, self.alerts, processes, *followed_closely)
        self.world.tell("cell", cell_of(settings))

    @asynccontextmanager
    async def at_work(self, _: FastAPI) -> AsyncIterator[None]:
        """Follow everything until the server ends."""
        self.entities.require_key()
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
        "Web UI",
        description=__doc__ or "",
        lifespan=screen.at_work,
        checks={"page": screen.check_page, "storage": storage_check(settings.data_dir)},
    )
    screen.entities.mount(app)
    _add_own(app, screen)
    _add_doors(app, screen)
    _add_page(app, screen)
    return SecureHeaders(app)


def _add_own(app: FastAPI, screen: Screen) -> None:
    @app.websocket("/api/live")
    async def live(page: WebSocket) -> None:
        await screen.live.show(page)

    @app.get("/api/events", tags=["events"])
    async def events(
        after: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        before: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        limit: Annotated[int, Query(ge=1, le=MOST_AT_ONCE)] = 200,
    ) -> list[dict[str, Any]]:
        """Return events, oldest first: the first after a `seq`, the last before one, or the newest."""
        if after is not None:
            return await screen.events.after(after, limit)
        return await screen.events.before(before, limit)

    @app.post("/api/alerts/{alert}/acknowledge", tags=["alerts"])
    async def acknowledge(alert: str, said: Acknowledgement) -> dict[str, Any]:
        """Acknowledge an alert: 404 if there is none, 409 if somebody has acknowledged it."""
        return await screen.alerts.acknowledge(alert, said.by.strip())

    @app.post("/api/alerts/acknowledge", tags=["alerts"])
    @max_body(MAX_ALERTS_BYTES)
    async def acknowledge_many(said: ManyAlerts) -> dict[str, Any]:
        """Acknowledge many alerts: `done` lists their ids, `failed` the others with the reason of each."""
        return await screen.alerts.acknowledge_many(said.alerts, said.by.strip())

    @app.post("/api/alerts/shelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BYTES)
    async def shelve(said: Shelving) -> dict[str, Any]:
        """Shelve alerts for some minutes, after which they return by themselves: `done` and `failed`."""
        until = datetime.now(UTC) + timedelta(minutes=said.minutes)
        return await screen.alerts.shelve_many(said.alerts, said.by.strip(), until)

    @app.post("/api/alerts/unshelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BYTES)
    async def unshelve(said: ManyAlerts) -> dict[str, Any]:
        """End the shelving of alerts now: `done` and `failed`."""
        return await screen.alerts.unshelve_many(said.alerts, said.by.strip())

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
    @accepts(*ANY_TYPE)  # the service behind decides, also how much less than this it takes
    @max_body(MAX_PASSED_BYTES)
    async def pass_through(service: str, path: str, request: Request) -> Response:  # noqa: ARG001
        return await screen.doors.pass_through(service, _still_quoted(request, service), request)

    @app.api_route("/api/{rest:path}", methods=list(METHODS), include_in_schema=False)
    @accepts(*ANY_TYPE)
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
