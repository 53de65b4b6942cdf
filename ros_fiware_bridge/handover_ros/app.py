"""The REST interface of the ROS bridge: its rules with rates, last values and errors, and the live graph."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard
from handover.service_addresses import ROS_BRIDGE
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_ros import mapping
from handover_ros.graph.joining import load_adapter
from handover_ros.joining import join
from handover_ros.mapping.document import Document
from handover_ros.routes import robot_sockets, rules
from handover_ros.routes.rules import BridgeHolder
from handover_ros.rules import plan as planning
from handover_ros.running.bridge import Bridge
from handover_ros.settings import BridgeSettings


def make_app(settings: BridgeSettings) -> FastAPI:
    """Return the application. Raises `UsageError` if the settings or the mapping cannot work."""
    load_adapter(settings.ros_adapter)
    document = read_mapping(settings)
    store = planning.type_store(document)
    planning.make(document, store, settings.factory)  # report errors of the mapping before anything starts
    guard = Guard(settings, ROS_BRIDGE)
    broker = BrokerClient(settings, credentials=guard.access)
    holder = BridgeHolder()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        graph = await join(
            settings, store, goals_file=settings.data_dir / f"{settings.bridge_name}-goals.json"
        )
        try:
            made = planning.make(document, store, settings.factory)
            bridge = Bridge(
                made,
                graph,
                broker,
                settings,
                url=settings.url,
                name=settings.bridge_name,
                parameters=settings.ros_adapter in {"auto", "cyclone"},  # rclpy serves its own
            )
            bridge.tasks.mount(app)
            async with broker, bridge:
                holder.bridge = bridge
                yield
                holder.bridge = None
        finally:
            await graph.close()

    async def subscribed() -> None:
        await holder.get().probe()

    app = create_app(
        "ROS bridge",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "subscriptions": subscribed,
            "storage": storage_check(settings.data_dir),
        },
        guard=guard,
        audit=AuditTrail(settings, ROS_BRIDGE),
    )
    rules.add_routes(app, holder, settings)
    robot_sockets.add_routes(app, lambda: holder.get().graph)
    return app


def read_mapping(settings: BridgeSettings) -> Document:
    """Return the configured mapping; without one, a mapping without rules. Raises `UsageError`."""
    if settings.ros_mapping is None:
        return mapping.parse("", "no mapping (HANDOVER_ROS_MAPPING)")
    return mapping.load(settings.ros_mapping)
