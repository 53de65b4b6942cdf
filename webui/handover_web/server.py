"""The web UI server: the page, its WebSocket, its own REST routes, and a proxy to the services."""

import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib.metadata import PackageNotFoundError
from typing import Annotated
from urllib.parse import quote

import httpx
from fastapi import FastAPI, Query, Request, Response, WebSocket
from pydantic import ConfigDict, Field
from starlette.types import ASGIApp

from handover.broker import BrokerClient
from handover.database import connect
from handover.distribution import version
from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.body_limit import max_body
from handover.network.tls_trust import client_context
from handover.security.audit_trail import AuditTrail
from handover.security.caller import Caller, CallerKind
from handover.security.guard import (
    authenticated,
    in_path,
    on_new_grants,
    require,
    require_signed_in,
    require_somewhere,
)
from handover.security.permissions import Permission
from handover.service_addresses import (
    ASSISTIVE_DEVICES,
    BROKER,
    GATEWAY,
    HUMAN_STATE,
    TRAJECTORY,
    WHOLE_BODY_CONTROL,
)
from handover.serving.service import ANY_TYPE, accepts, create_app, method_not_allowed, methods_of
from handover.serving.storage import storage_check
from handover_web.http.control_proxy import ControlProxy
from handover_web.http.other_broker import OtherBroker
from handover_web.http.page_files import PageFiles
from handover_web.http.page_guard import CsrfCheck, PageGuard
from handover_web.http.person_removal import PersonRemoval, add_person_removal
from handover_web.http.provider_routes import add_provider_sign_in
from handover_web.http.proxy import METHODS, ServiceProxy
from handover_web.http.secure_headers import SecureHeaders
from handover_web.http.session_routes import add_sessions
from handover_web.http.sign_in_rate import SignInRate
from handover_web.http.stream_proxy import StreamProxy
from handover_web.http.user_settings import UserSettings, add_user_settings
from handover_web.live.event_log import MAX_EVENTS_PER_REQUEST, MAX_SEQ, EventLog
from handover_web.live.live_socket import LiveSocket
from handover_web.live.live_state import LiveState, Reader
from handover_web.live.viewers import Viewers
from handover_web.live.views import AlertsResult, AlertView, CellSummary, CellView, LiveEvent, OperatorView
from handover_web.service_credentials import ServiceCredentials
from handover_web.settings import WebuiSettings
from handover_web.simulated_operator import DEFAULT_GLOVE, SimulatedOperator
from handover_web.sources.alerts import MAX_ALERTS_AT_ONCE, MAX_SHELVING, Alerts
from handover_web.sources.broker_abilities import BrokerAbilities
from handover_web.sources.broker_entities import BrokerEntities
from handover_web.sources.cells import Cells
from handover_web.sources.devices import Devices
from handover_web.sources.extra_services import ExtraService, extra_services
from handover_web.sources.gloves import Gloves
from handover_web.sources.on_demand import SourceContext
from handover_web.sources.people import People
from handover_web.sources.processes import ProcessEntities, Processes
from handover_web.sources.registered_devices import RegisteredDevices
from handover_web.sources.robots import Robots
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.source import run_sources
from handover_web.sources.tasklist import CommentCounts, Tasklist
from handover_web.sources.tasks import Tasks

ACCOUNTS = "accounts"
DELETED_USER = re.compile(r"users/([^/]+)")
MAX_PROXIED_BODY_BYTES = 4 * 1024 * 1024
MAX_ALERTS_BODY_BYTES = 256 * 1024
"""Enough for the ids of `MAX_ALERTS_AT_ONCE` Alerts."""


class AcknowledgeRequest(StrictModel):
    """The person who acknowledges an alert."""

    model_config = ConfigDict(extra="forbid")

    by: Annotated[str, Field(min_length=1, max_length=100, pattern=r"\S")]


Acknowledger = Annotated[Caller, require(Permission.ACKNOWLEDGE_ALERTS)]

Ids = Annotated[
    list[Annotated[str, Field(min_length=1, max_length=2000)]],
    Field(min_length=1, max_length=MAX_ALERTS_AT_ONCE),
]


class AlertsRequest(AcknowledgeRequest):
    """Alerts, and the person who acts on them."""

    alerts: Ids


class ShelveRequest(AlertsRequest):
    """Alerts to shelve, and the duration."""

    minutes: Annotated[float, Field(gt=0, le=MAX_SHELVING.total_seconds() / 60)]


class StartOperatorRequest(StrictModel):
    """The glove that the simulated operator wears."""

    model_config = ConfigDict(extra="forbid")

    glove: str = DEFAULT_GLOVE


class Components:
    """All parts of the server, wired together."""

    def __init__(self, settings: WebuiSettings, page: PageFiles) -> None:
        self.page = page
        self.guard = guard = PageGuard(settings)
        self.state = LiveState()
        self.viewers = Viewers()
        engine = connect(settings.database("webui"))
        self.audit = AuditTrail(settings, "webui", engine)
        self.events = EventLog(engine, self.state.publish_event)
        self.user_settings = UserSettings(engine)
        self.broker = BrokerClient(settings, credentials=guard.access)
        urls = settings.service_urls
        self.http = http = httpx.AsyncClient(
            auth=ServiceCredentials(guard.access, (url for name, url in urls.items() if name != BROKER)),
            trust_env=False,
            verify=client_context(*settings.ca_files),
        )
        self.operator = SimulatedOperator(settings, http, guard.access, self.state, self.events)
        self.live_socket = LiveSocket(self.state, self.viewers)
        # Human state starts only where its extra is installed, which this machine cannot know of another;
        # assistive devices only with a machine, whole-body control only with a humanoid.
        optional = (HUMAN_STATE, ASSISTIVE_DEVICES, WHOLE_BODY_CONTROL)
        own = {name: url for name, url in urls.items() if name not in optional}
        extra = (
            *(ExtraService(name, urls[name], is_wanted=False) for name in optional),
            *extra_services(settings),
        )
        services = ServiceMonitor(
            own, http, BrokerAbilities(settings, self.broker), self.state, self.events, extra=extra
        )
        devices = Devices(self.state, self.events, services)
        processes = Processes(settings, http, self.state, self.events, services)
        self.tasklist = Tasklist(self.state)
        tasks = Tasks(self.events, devices, services, processes.refresh, self.tasklist)
        self.alerts = Alerts(self.state, self.events, self.broker, processes.refresh)
        handlers = (devices, tasks, ProcessEntities(processes), self.alerts)
        self.entities = BrokerEntities(settings, self.broker, handlers, services)
        context = SourceContext(settings, http, self.state, self.viewers, services, guard.access)
        people = People(context)
        registered_devices = RegisteredDevices(context)
        comments = CommentCounts(self.state)

        def on_write(method: str, service: str, path: str) -> None:
            if (method, service) == ("DELETE", ACCOUNTS) and (user := DELETED_USER.fullmatch(path)):
                self.user_settings.delete(user[1])
            people.on_write(service)
            registered_devices.on_write(service)
            processes.on_write(service, path)
            comments.on_write(service, path)

        async def headers_of(request: Request, is_refused: bool) -> Mapping[str, str]:
            headers = dict(request.scope["headers"])
            session = guard.session_of(headers)
            if is_refused and session is not None:
                guard.forget(session)
            return await guard.service_headers(headers)

        self.control = ControlProxy(urls, guard, settings.ca_files)
        self.streams = StreamProxy(urls, guard, settings.ca_files)
        self.proxy = ServiceProxy(urls, on_write, settings.ca_files, headers_of)
        self.other_broker = OtherBroker(self.broker)
        self.cells = Cells(settings, self.broker)
        self.removal = PersonRemoval(urls, http, self.broker, headers_of)
        on_demand = (Gloves(context), Robots(context), people, registered_devices)
        self._sources = (services, self.entities, self.alerts, processes, *on_demand)
        self.state.publish("cell", cell_view(settings))

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Run all background tasks while the server runs."""
        self.entities.require_key()
        async with (
            self.broker,
            self.cells,
            self.http,
            self.proxy,
            self.events,
            self.operator,
            run_sources(self._sources),
        ):
            yield

    async def check_page(self) -> None:
        """Raise `Problem` 503 if the page is not built. The state of the services does not matter."""
        if not self.page.is_built:
            raise Problem(503, "Not built", "the page is not built; run make setup")


def make_app(settings: WebuiSettings, page: PageFiles | None = None) -> ASGIApp:
    """Return the application; raises `UsageError` for settings that it cannot work with."""
    components = Components(settings, page or PageFiles())
    app = create_app(
        "Web UI",
        description=__doc__ or "",
        lifespan=components.lifespan,
        checks={"page": components.check_page, "storage": storage_check(settings.data_dir)},
        guard=components.guard,
        audit=components.audit,
        audit_prefix="/api/webui",
    )
    components.entities.mount(app)
    add_sessions(app, components.guard)
    add_user_settings(app, components.user_settings)
    add_person_removal(app, components.removal)
    add_provider_sign_in(app, components.guard)
    _add_api(app, components)
    _add_proxy(app, components)
    _add_page(app, components)
    return SecureHeaders(SignInRate(CsrfCheck(app, components.guard)))


def _add_api(app: FastAPI, components: Components) -> None:
    @app.websocket("/api/live", dependencies=[require_somewhere(Permission.READ)])
    async def live(socket: WebSocket) -> None:
        reader = Reader(partial((await authenticated(socket)).may, Permission.READ))
        on_new_grants(socket, lambda caller: reader.change(partial(caller.may, Permission.READ)))
        await components.live_socket.serve(socket, reader)

    @app.websocket(
        "/api/trajectory-tool/robots/{robot}/control",
        dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))],
    )
    async def control(socket: WebSocket, robot: str) -> None:
        await components.control.serve(socket, TRAJECTORY, _control_of(robot))

    @app.websocket(
        "/api/device-gateway/robots/{robot}/control",
        dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))],
    )
    async def drive(socket: WebSocket, robot: str) -> None:
        await components.control.serve(socket, GATEWAY, _control_of(robot))

    @app.websocket(
        "/api/human-state/people/{person}/live",
        dependencies=[require(Permission.READ_HEALTH_DATA, in_path("Person", "person"))],
    )
    async def health(socket: WebSocket, person: str) -> None:
        await components.streams.serve(socket, HUMAN_STATE, f"/people/{quote(person, safe='')}/live")

    # The service requires the permissions for its humanoid, whose name it alone knows.
    @app.websocket("/api/whole-body-control/live", dependencies=[require_somewhere(Permission.READ)])
    async def humanoid_live(socket: WebSocket) -> None:
        await components.streams.serve(socket, WHOLE_BODY_CONTROL, "/live")

    @app.websocket(
        "/api/whole-body-control/input", dependencies=[require_somewhere(Permission.PERFORM_TASKS)]
    )
    async def humanoid_input(socket: WebSocket) -> None:
        await components.control.serve(socket, WHOLE_BODY_CONTROL, "/input")

    @app.get("/api/events", tags=["events"])
    async def events(
        caller: Annotated[Caller, require_somewhere(Permission.READ)],
        after: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        before: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        limit: Annotated[int, Query(ge=1, le=MAX_EVENTS_PER_REQUEST)] = 200,
    ) -> list[LiveEvent]:
        """Return events, oldest first: after a `seq`, before one, or the newest.

        Events are about everything, so a caller who may not read everything gets none.
        """
        if not caller.may(Permission.READ):
            return []
        if after is not None:
            return await components.events.after(after, limit)
        return await components.events.before(before, limit)

    @app.get("/api/webui/cells", tags=["cells"], dependencies=[require(Permission.READ)])
    async def cells() -> list[CellSummary]:
        """Return the cells on the broker; 503 while it cannot be read."""
        return await components.cells.summaries()

    @app.post("/api/alerts/{alert}/acknowledge", tags=["alerts"])
    async def acknowledge(caller: Acknowledger, alert: str, body: AcknowledgeRequest) -> AlertView:
        """Acknowledge an alert: 404 for an unknown one, 409 if it is acknowledged already."""
        return await components.alerts.acknowledge(alert, _name(caller, body))

    @app.post("/api/alerts/acknowledge", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def acknowledge_many(caller: Acknowledger, body: AlertsRequest) -> AlertsResult:
        """Acknowledge alerts: `done` lists ids, `failed` the others with problem details."""
        return await components.alerts.acknowledge_many(body.alerts, _name(caller, body))

    @app.post("/api/alerts/shelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def shelve(caller: Acknowledger, body: ShelveRequest) -> AlertsResult:
        """Shelve alerts for some minutes, after which they return by themselves."""
        until = datetime.now(UTC) + timedelta(minutes=body.minutes)
        return await components.alerts.shelve_many(body.alerts, _name(caller, body), until)

    @app.post("/api/alerts/unshelve", tags=["alerts"])
    @max_body(MAX_ALERTS_BODY_BYTES)
    async def unshelve(caller: Acknowledger, body: AlertsRequest) -> AlertsResult:
        """End the shelving of alerts now."""
        return await components.alerts.unshelve_many(body.alerts, _name(caller, body))

    configure = [require(Permission.CONFIGURE)]

    @app.post("/api/operator", status_code=201, tags=["operator"], dependencies=configure)
    async def start_operator(body: StartOperatorRequest) -> OperatorView:
        """Start the simulated operator: 409 if it is running or the glove is in use."""
        return await components.operator.start(body.glove)

    @app.delete("/api/operator", tags=["operator"], dependencies=configure)
    async def stop_operator() -> OperatorView:
        """Stop the simulated operator; has no effect if it is not running."""
        return await components.operator.stop()


def _control_of(robot: str) -> str:
    return f"/robots/{quote(robot, safe='')}/control"


def _name(caller: Caller, body: AcknowledgeRequest) -> str:
    """Return who acts: the user, or in local mode the name that the page asked for."""
    return body.by.strip() if caller.kind is CallerKind.LOCAL else caller.name


def _add_proxy(app: FastAPI, components: Components) -> None:
    methods = list(METHODS)
    signed_in = [require_signed_in()]  # the service itself requires the permission

    @app.api_route(
        "/api/{service}/{path:path}", methods=methods, include_in_schema=False, dependencies=signed_in
    )
    @accepts(*ANY_TYPE)  # the service itself decides, and may accept less
    @max_body(MAX_PROXIED_BODY_BYTES)
    async def forward(service: str, path: str, request: Request) -> Response:  # noqa: ARG001
        if not components.proxy.serves(service):
            _require_other_path(request)
        encoded = _encoded_path(request, service)
        answer = await components.other_broker.answer(encoded, request) if service == BROKER else None
        return await components.proxy.forward(service, encoded, request) if answer is None else answer

    @app.api_route("/api/{rest:path}", methods=methods, include_in_schema=False, dependencies=signed_in)
    @accepts(*ANY_TYPE)
    async def not_found(rest: str, request: Request) -> Response:
        _require_other_path(request)
        raise Problem(404, "Not found", f"there is no route /api/{rest}")


def _add_page(app: FastAPI, components: Components) -> None:
    @app.api_route("/{address:path}", methods=["GET", "HEAD"], include_in_schema=False)
    async def page(address: str, request: Request) -> Response:
        return await components.page.respond(address, request.headers)


def _require_other_path(request: Request) -> None:
    """Raise `Problem` 405 at the path of a route of this server, which has other methods."""
    if request.method not in methods_of(request):
        raise method_not_allowed(request)


def _encoded_path(request: Request, service: str) -> str:
    """Return the path within the service, still percent-encoded: an encoded slash separates nothing."""
    raw = bytes(request.scope.get("raw_path") or request.scope["path"].encode())
    return raw.partition(b"?")[0].decode("latin-1").removeprefix(f"/api/{service}/")


def _version() -> str:
    try:
        return version()
    except PackageNotFoundError:
        return "0"


def cell_view(settings: WebuiSettings) -> CellView:
    """Return the topic `cell`: the factory, the version, the location of the emergency stop."""
    cell: CellView = {"factory": settings.factory, "version": _version()}
    if settings.emergency_stop:
        cell["emergencyStop"] = settings.emergency_stop
    return cell
