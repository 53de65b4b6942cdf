"""The device gateway: devices and robots join over TCP and TLS, and are commanded and observed by REST."""

from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.control.leasing import OpenSessions
from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service_addresses import DEVICE_GATEWAY
from handover.serving.leadership import Leadership
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_devices import metrics
from handover_devices.adapters.base import configured
from handover_devices.anomalies.anomalies import Anomalies
from handover_devices.anomalies.monitor import Monitor
from handover_devices.broker_reports import BrokerReports
from handover_devices.camera_images import CameraImages
from handover_devices.certificate_alerts import CertificateAlerts
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.connection.device_server import DeviceServer
from handover_devices.device_inputs import DeviceInputs
from handover_devices.device_tasks import DeviceTasks
from handover_devices.edge.edge_app import make_edge_app
from handover_devices.gateway import DeviceGateway
from handover_devices.protocol.times import TimeRule
from handover_devices.registry.device import Device
from handover_devices.relaying import EdgeRelays
from handover_devices.replicas.following import Following
from handover_devices.replicas.forwarding import ToLeader
from handover_devices.replicas.leading import begin_term, leader_at
from handover_devices.replicas.sessions import ReplicaSessions
from handover_devices.routes.adapter_routes import add_adapter_routes
from handover_devices.routes.anomaly_routes import add_anomaly_routes
from handover_devices.routes.camera_routes import add_camera_routes
from handover_devices.routes.command_routes import add_command_routes
from handover_devices.routes.control_routes import add_control_routes
from handover_devices.routes.device_routes import add_device_routes
from handover_devices.routes.drive_routes import AWAY_CODE, add_drive_routes
from handover_devices.routes.history_routes import add_history_routes
from handover_devices.settings import GatewaySettings
from handover_devices.storage import schema
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.retention import rule_of
from handover_devices.upkeep import RegistryEntities, keep_retention


def make_app(settings: GatewaySettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    return _central_app(settings) if settings.edge_upstream is None else make_edge_app(settings)


def _central_app(settings: GatewaySettings) -> FastAPI:
    parts = _Parts(settings)
    gateway, engine = parts.gateway, parts.engine
    app = create_app(
        "Device gateway",
        description=__doc__ or "",
        lifespan=parts.lifespan,
        checks={
            "broker": parts.broker.probe,
            "tasks": parts.check_tasks,
            "storage": storage_check(settings.data_dir),
        },
        guard=parts.guard,
        audit=AuditTrail(settings, DEVICE_GATEWAY, engine),
    )
    app.add_middleware(ToLeader, settings=settings, gateway=gateway, following=parts.following)
    parts.device_tasks.mount(app)
    add_device_routes(app, settings, gateway, engine, parts.broker)
    add_adapter_routes(app, parts.adapters)
    add_command_routes(app, parts.dispatcher, gateway, engine)
    add_control_routes(app, settings, gateway, parts.inputs)
    add_drive_routes(app, gateway, parts.drives)
    add_history_routes(app, gateway, engine)
    add_camera_routes(app, settings, gateway, parts.images)
    add_anomaly_routes(app, settings, gateway, engine, parts.anomalies)
    return app


class _Parts:
    """The parts of a central gateway. Of several replicas one leads, and the others relay to it."""

    def __init__(self, settings: GatewaySettings) -> None:
        engine = self.engine = connect(settings.database("devices"))
        self.settings = settings
        self.guard = Guard(settings, DEVICE_GATEWAY)
        self.broker = BrokerClient(settings, credentials=self.guard.access)
        self.history = HistoryWriter(engine)
        self.dispatcher = Dispatcher(engine, self.history)
        self.reports = BrokerReports(
            settings, self.broker, settings.device_report_interval_s, settings.device_reports_per_s
        )
        times = TimeRule(settings.device_max_age_h * 3600, settings.device_max_ahead_s)
        gateway = DeviceGateway(engine, self.history, self.dispatcher, self.reports, times)
        self.gateway = gateway
        self.device_tasks = DeviceTasks(settings, self.broker, gateway, self.dispatcher)
        edge_times = TimeRule(settings.device_edge_max_age_h * 3600, settings.device_max_ahead_s)
        self.relays = EdgeRelays(gateway, edge_times)
        self.server = DeviceServer(settings, gateway, self.relays)
        self.replicas = self.server.connections.replicas = ReplicaSessions(gateway, edge_times)
        self.following = Following(settings, engine, gateway, edge_times, self.relays)
        self.leadership = Leadership(engine, DEVICE_GATEWAY)
        self.adapters = configured(settings, gateway)
        self.anomalies = Anomalies(settings, engine, self.history, self.broker, self.guard.access)
        self.inputs, self.images = DeviceInputs(settings, gateway), CameraImages()
        self.drives = OpenSessions()

    @asynccontextmanager
    async def lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Serve devices; lead, or relay to the replica that does."""
        schema.prepare(self.engine)
        async with self.broker, BackgroundTasks("history of devices") as tasks:
            tasks.start(self.history.run)
            if self.gateway.is_shared:
                await self.gateway.load_devices()
                self.following.begin()
            async with self.leadership.led(self.lead), self.server:
                yield
            await self.following.end()
        await self.history.close()
        self.engine.dispose()

    @asynccontextmanager
    async def lead(self) -> AsyncIterator[None]:
        """Do what one process does for all."""
        gateway, monitor = self.gateway, self.anomalies.monitor
        try:
            leader = leader_at(self.settings, self.server.tls_name)
            await self.following.end()
            await begin_term(self.leadership, gateway, leader)
            gateway.dispatcher, gateway.reports = self.dispatcher, self.reports
            await gateway.load()
            self.following.take_over()
            self.replicas.token = leader.token
            async with (
                BackgroundTasks("device gateway") as tasks,
                self.inputs,
                reporting_writer(DEVICE_GATEWAY, self.settings, self.broker) as writer,
            ):
                entities = RegistryEntities(self.settings, self.broker, writer)
                certificates = CertificateAlerts(self.settings, self.broker, gateway.devices)
                await self.anomalies.load()
                changed = _follow_changes(
                    gateway,
                    entities=entities,
                    certificates=certificates,
                    monitor=monitor,
                    device_tasks=self.device_tasks,
                    others=(self.relays, self.replicas),
                    images=self.images,
                    tasks=tasks,
                )
                gateway.on_values = monitor.observe
                tasks.start_restarting(self.dispatcher.run)
                tasks.start_restarting(self.reports.run)
                tasks.start_restarting(certificates.run)
                tasks.start_restarting(keep_retention, self.history, rule_of(self.settings))
                async with self.device_tasks:
                    for device in gateway.devices.values():
                        changed(device)
                    adapters = (adapter.run for adapter in self.adapters.values())
                    for work in (*self.anomalies.work(), *adapters):
                        tasks.start_restarting(work)
                    metrics.LEADS.set(1)
                    yield
        finally:
            metrics.LEADS.set(0)
            self.replicas.close()
            self.drives.end_all(AWAY_CODE, "another gateway leads")
            self.dispatcher.clear()
            self.history.discard_commands()
            self.history.term = None
            if gateway.is_shared:
                self.following.begin()

    async def check_tasks(self) -> None:
        """Raise an error while Tasks are not performed here, nor by a leader that is connected."""
        if self.following.is_active:
            await self.following.check()
        else:
            await self.device_tasks.probe()


def _follow_changes(
    gateway: DeviceGateway,
    *,
    entities: RegistryEntities,
    certificates: CertificateAlerts,
    monitor: Monitor,
    device_tasks: DeviceTasks,
    others: Sequence[EdgeRelays | ReplicaSessions],
    images: CameraImages,
    tasks: BackgroundTasks,
) -> Callable[[Device], None]:
    """Pass on which devices change; return the function to call with a device that was added or changed."""

    def changed(device: Device) -> None:
        entities.write(device)
        monitor.set_device(device.name, device.values)
        certificates.request()
        for other in others:
            other.changed(device)
        tasks.start(device_tasks.follow, device.name)

    def removed(name: str) -> None:
        tasks.start(device_tasks.follow, name)
        entities.delete(name)
        monitor.set_device(name, None)
        certificates.request()
        for other in others:
            other.removed(name)
        images.delete(name)

    gateway.on_changed, gateway.on_removed = changed, removed
    gateway.on_image = images.put_part
    return changed
