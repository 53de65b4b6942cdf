"""The REST interface of the ROS bridge: its rules with rates, last values and errors, and the live graph."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI, Request, Response

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.messages import message
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard, require
from handover.security.permissions import Permission
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY
from handover_ros import mapping, robot_sockets
from handover_ros.graph.joining import load_adapter
from handover_ros.inspection import graph_view
from handover_ros.joining import join
from handover_ros.mapping.document import Document
from handover_ros.rules import plan as planning
from handover_ros.running.bridge import Bridge
from handover_ros.running.rule_view import RuleView
from handover_ros.settings import BridgeSettings


class _BridgeHolder:
    """Holds the bridge while it runs."""

    bridge: Bridge | None = None

    def get(self) -> Bridge:
        if self.bridge is None:
            raise Problem(
                503,
                "Not ready",
                message("ros.not_ready", "the ROS bridge is starting; try again in a moment"),
            )
        return self.bridge


def make_app(settings: BridgeSettings) -> FastAPI:
    """Return the application. Raises `UsageError` if the settings or the mapping cannot work."""
    load_adapter(settings.ros_adapter)
    document = read_mapping(settings)
    store = planning.type_store(document)
    planning.make(document, store, settings.factory)  # report errors of the mapping before anything starts
    guard = Guard(settings, "ros-bridge")
    broker = BrokerClient(settings, credentials=guard.access)
    holder = _BridgeHolder()

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
        audit=AuditTrail(settings, "ros-bridge"),
    )
    _add_routes(app, holder, settings)
    robot_sockets.add_routes(app, lambda: holder.get().graph)
    return app


def read_mapping(settings: BridgeSettings) -> Document:
    """Return the configured mapping; without one, a mapping without rules. Raises `UsageError`."""
    if settings.ros_mapping is None:
        return mapping.parse("", "no mapping (HANDOVER_ROS_MAPPING)")
    return mapping.load(settings.ros_mapping)


def _add_routes(app: FastAPI, holder: _BridgeHolder, settings: BridgeSettings) -> None:
    @app.get("/rules", tags=["rules"], dependencies=[require(Permission.READ)])
    async def rules() -> Sequence[RuleView]:
        """Return every rule with its rates, last value and last error."""
        return holder.get().views()

    @app.get("/rules/{rule}", tags=["rules"], dependencies=[require(Permission.READ)])
    async def one_rule(rule: str) -> RuleView:
        """Return a rule with its rates, last value and last error."""
        return holder.get().view(rule)

    @app.post("/rules/{rule}/enable", tags=["rules"], dependencies=[require(Permission.CONFIGURE)])
    async def enable(rule: str) -> RuleView:
        """Switch a rule on; it stays on after a restart."""
        await holder.get().switch(rule, on=True)
        return holder.get().view(rule)

    @app.post("/rules/{rule}/disable", tags=["rules"], dependencies=[require(Permission.CONFIGURE)])
    async def disable(rule: str) -> RuleView:
        """Switch a rule off; it stays off after a restart."""
        await holder.get().switch(rule, on=False)
        return holder.get().view(rule)

    @app.get("/graph", tags=["graph"], dependencies=[require(Permission.READ)])
    async def graph() -> dict[str, Any]:
        """Return the nodes, topics, services and actions of the ROS graph."""
        by_dds = settings.ros_adapter != "rosbridge"
        return {
            "domain": settings.ros_domain_id if by_dds else None,
            **graph_view.of(holder.get().graph),
        }

    @app.get("/broker", tags=["graph"], dependencies=[require(Permission.READ)])
    async def broker_link() -> dict[str, Any]:
        """Return the state of the connection to the broker: availability, pending updates, subscriptions."""
        bridge = holder.get()
        return {
            "url": bridge.broker.url,
            "available": bridge.broker_writer.away_since_s is None,
            "pending": len(bridge.broker_writer.outbox),
            "subscribed": bridge.listeners.subscribed,
        }

    @app.post(
        "/notifications/{rule}",
        status_code=204,
        tags=["notifications"],
        dependencies=[REQUIRES_NOTIFICATION_KEY],
    )
    async def notify(rule: str, request: Request) -> Response:
        """Have a rule process the current state of the entities in a notification."""
        listeners = holder.get().listeners
        await listeners.take_notification(rule, request)
        return Response(status_code=204)
