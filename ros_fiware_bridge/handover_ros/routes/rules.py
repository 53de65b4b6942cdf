"""REST of the ROS bridge: its rules, the live graph, the connection to the broker, and notifications."""

from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI, Request, Response

from handover.errors import Problem
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY
from handover_ros.inspection import graph_view
from handover_ros.running.bridge import Bridge
from handover_ros.running.rule_view import RuleView
from handover_ros.settings import BridgeSettings


class BridgeHolder:
    """Holds the bridge while it runs."""

    bridge: Bridge | None = None

    def get(self) -> Bridge:
        """Return the bridge; raise `Problem` 503 while it starts."""
        if self.bridge is None:
            raise Problem.translated(
                503, "Not ready", "ros.not_ready", "the ROS bridge is starting; try again in a moment"
            )
        return self.bridge


def add_routes(app: FastAPI, holder: BridgeHolder, settings: BridgeSettings) -> None:
    """Add the routes."""

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
