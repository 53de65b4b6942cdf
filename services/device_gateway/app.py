"""The device gateway: devices and robots join over TCP and TLS, and are commanded and observed by REST."""

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.background_tasks import BackgroundTasks
from handover.broker import BrokerClient
from handover.database import connect
from handover.latest_value_writer import LatestValueWriter
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service import create_app
from handover.storage import storage_check
from services.device_gateway.adapters.base import configured
from services.device_gateway.anomalies.anomalies import Anomalies
from services.device_gateway.anomalies.monitor import Monitor
from services.device_gateway.broker_reports import BrokerReports
from services.device_gateway.camera_images import CameraImages
from services.device_gateway.certificate_alerts import CertificateAlerts
from services.device_gateway.commands.dispatcher import Dispatcher
from services.device_gateway.connection.device_server import DeviceServer
from services.device_gateway.device_inputs import DeviceInputs
from services.device_gateway.device_tasks import DeviceTasks
from services.device_gateway.edge.edge_app import make_edge_app
from services.device_gateway.gateway import DeviceGateway
from services.device_gateway.protocol.times import TimeRule
from services.device_gateway.registry.device import Device
from services.device_gateway.relaying import EdgeRelays
from services.device_gateway.routes.adapter_routes import add_adapter_routes
from services.device_gateway.routes.anomaly_routes import add_anomaly_routes
from services.device_gateway.routes.camera_routes import add_camera_routes
from services.device_gateway.routes.command_routes import add_command_routes
from services.device_gateway.routes.control_routes import add_control_routes
from services.device_gateway.routes.device_routes import add_device_routes
from services.device_gateway.routes.drive_routes import add_drive_routes
from services.device_gateway.routes.history_routes import add_history_routes
from services.device_gateway.settings import GatewaySettings
from services.device_gateway.storage import schema
from services.device_gateway.storage.history_writer import HistoryWriter
from services.device_gateway.storage.retention import rule_of
from services.device_gateway.upkeep import RegistryEntities, keep_retention


def make_app(settings: GatewaySettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    return _central_app(settings) if settings.edge_upstream is None else make_edge_app(settings)


def _central_app(settings: GatewaySettings) -> FastAPI:
    engine = connect(settings.database("devices"))
    guard = Guard(settings, "device-gateway")
    broker = BrokerClient(settings, credentials=guard.access)
    history = HistoryWriter(engine)
    dispatcher = Dispatcher(engine, history, settings.device_ack_timeout_s)
    reports = BrokerReports(
        settings, broker, settings.device_report_interval_s, settings.device_reports_per_s
    )
    times = TimeRule(settings.device_max_age_h * 3600, settings.device_max_ahead_s)
    gateway = DeviceGateway(engine, history, dispatcher, reports, times)
    device_tasks = DeviceTasks(settings, broker, gateway)
    edge_times = TimeRule(settings.device_edge_max_age_h * 3600, settings.device_max_ahead_s)
    relays = EdgeRelays(gateway, edge_times)
    server = DeviceServer(settings, gateway, relays)
    adapters = configured(settings, gateway)
    anomalies = Anomalies(settings, engine, history, broker, guard.access)
    monitor = anomalies.monitor

    inputs, images = DeviceInputs(settings, gateway), CameraImages()

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        schema.prepare(engine)
        await gateway.load()
        async with broker, BackgroundTasks("device gateway") as tasks, inputs, LatestValueWriter() as writer:
            entities = RegistryEntities(settings, broker, writer)
            certificates = CertificateAlerts(settings, broker, gateway.devices)
            changed = _follow_changes(
                gateway,
                entities=entities,
                certificates=certificates,
                monitor=monitor,
                device_tasks=device_tasks,
                relays=relays,
                images=images,
                tasks=tasks,
            )
            gateway.on_values = monitor.observe
            tasks.start(history.run)
            tasks.start_restarting(dispatcher.run)
            tasks.start_restarting(reports.run)
            tasks.start_restarting(certificates.run)
            tasks.start_restarting(keep_retention, history, rule_of(settings))
            await anomalies.load()
            async with device_tasks:
                for device in gateway.devices.values():
                    changed(device)
                for work in (*anomalies.work(), *(adapter.run for adapter in adapters.values())):
                    tasks.start_restarting(work)
                async with server:
                    yield
        await history.close()
        engine.dispose()

    app = create_app(
        "Device gateway",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "tasks": device_tasks.probe,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, "device-gateway", engine),
    )
    device_tasks.mount(app)
    add_device_routes(app, settings, gateway, engine, broker)
    add_adapter_routes(app, adapters)
    add_command_routes(app, gateway, engine)
    _add_routes_of_control(app, settings, gateway, inputs)
    add_history_routes(app, gateway, engine)
    add_camera_routes(app, settings, gateway, images)
    add_anomaly_routes(app, settings, gateway, engine, anomalies)
    return app


def _follow_changes(
    gateway: DeviceGateway,
    *,
    entities: RegistryEntities,
    certificates: CertificateAlerts,
    monitor: Monitor,
    device_tasks: DeviceTasks,
    relays: EdgeRelays,
    images: CameraImages,
    tasks: BackgroundTasks,
) -> Callable[[Device], None]:
    """Pass on which devices change; return the function to call with a device that was added or changed."""

    def changed(device: Device) -> None:
        entities.write(device)
        monitor.set_device(device.name, device.values)
        certificates.request()
        relays.changed(device)
        tasks.start(device_tasks.follow, device.name)

    def removed(name: str) -> None:
        tasks.start(device_tasks.follow, name)
        entities.delete(name)
        monitor.set_device(name, None)
        certificates.request()
        relays.removed(name)
        images.delete(name)

    gateway.on_changed, gateway.on_removed = changed, removed
    gateway.on_image = images.put_part
    return changed


def _add_routes_of_control(
    app: FastAPI, settings: GatewaySettings, gateway: DeviceGateway, inputs: DeviceInputs
) -> None:
    add_control_routes(app, settings, gateway, inputs)
    add_drive_routes(app, gateway)
