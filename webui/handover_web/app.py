"""The web UI server: the page, its WebSocket, its own REST routes, and a proxy to the services."""

import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from importlib.metadata import PackageNotFoundError

import httpx
from fastapi import FastAPI, Request
from starlette.types import ASGIApp

from handover.broker import BrokerClient
from handover.database import connect
from handover.distribution import version
from handover.errors import Problem
from handover.network.tls_trust import client_context
from handover.security.audit_trail import AuditTrail
from handover.service_addresses import ASSISTIVE_DEVICES, BROKER, HUMAN_STATE, WEBUI, WHOLE_BODY_CONTROL
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_web.http.control_proxy import ControlProxy
from handover_web.http.other_broker import OtherBroker
from handover_web.http.page_files import PageFiles
from handover_web.http.page_guard import CsrfCheck, PageGuard
from handover_web.http.proxy import ServiceProxy
from handover_web.http.secure_headers import SecureHeaders
from handover_web.http.sign_in_rate import SignInRate
from handover_web.http.stream_proxy import StreamProxy
from handover_web.live.event_log import EventLog
from handover_web.live.live_socket import LiveSocket
from handover_web.live.live_state import LiveState
from handover_web.live.viewers import Viewers
from handover_web.live.views import CellView
from handover_web.routes.alerts import add_alerts
from handover_web.routes.cell import add_cell
from handover_web.routes.forwarding import add_forwarding, add_page
from handover_web.routes.person_removal import PersonRemoval, add_person_removal
from handover_web.routes.provider_sign_in import add_provider_sign_in
from handover_web.routes.sessions import add_sessions
from handover_web.routes.streams import add_streams
from handover_web.routes.user_settings import UserSettings, add_user_settings
from handover_web.service_credentials import ServiceCredentials
from handover_web.settings import WebuiSettings
from handover_web.simulated_operator import SimulatedOperator
from handover_web.sources.alerts import Alerts
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


class Components:
    """All parts of the server, wired together."""

    def __init__(self, settings: WebuiSettings, page: PageFiles) -> None:
        self.page = page
        self.guard = guard = PageGuard(settings)
        self.state = LiveState()
        self.viewers = Viewers()
        engine = connect(settings.database("webui"))
        self.audit = AuditTrail(settings, WEBUI, engine)
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
    add_streams(app, components.live_socket, components.control, components.streams)
    add_cell(app, components.events, components.cells, components.operator)
    add_alerts(app, components.alerts)
    add_forwarding(app, components.proxy, components.other_broker)
    add_page(app, components.page)
    return SecureHeaders(SignInRate(CsrfCheck(app, components.guard)))


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
