"""The face of the ROS bridge: its rules with their rates, last values and errors, and the live graph."""

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI, Request, Response
from httpx_aiohttp import AiohttpTransport

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.messages import message
from handover.service import create_app
from handover.storage import storage_check
from ros_fiware_bridge import graph_view, mapping
from ros_fiware_bridge.joining import join
from ros_fiware_bridge.mapping.document import Document
from ros_fiware_bridge.rules import plan as planning
from ros_fiware_bridge.running.bridge import Bridge
from ros_fiware_bridge.settings import BridgeSettings

RuleView = Mapping[str, Any]


class _At:
    """Where the bridge is found while it works."""

    bridge: Bridge | None = None

    def the_bridge(self) -> Bridge:
        if self.bridge is None:
            raise Problem(
                503,
                "Not ready",
                message("ros.not_ready", "the ROS bridge is starting; try again in a moment"),
            )
        return self.bridge


def make_app(settings: BridgeSettings) -> FastAPI:
    """Return the application; raises `UsageError` when it could not work as it is set."""
    document = read_mapping(settings)
    store = planning.type_store(document)
    planning.make(document, store, settings.factory)  # what is wrong with it is told before anything starts
    broker = BrokerClient(settings, transport=AiohttpTransport(trust_env=False))
    at = _At()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        graph = await join(settings, store)
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
                at.bridge = bridge
                yield
                at.bridge = None
        finally:
            await graph.close()

    async def subscribed() -> None:
        await at.the_bridge().probe()

    app = create_app(
        "ROS bridge",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={
            "broker": broker.probe,
            "subscriptions": subscribed,
            "storage": storage_check(settings.data_dir),
        },
    )
    _add_rules(app, at, settings)
    return app


def read_mapping(settings: BridgeSettings) -> Document:
    """Return the mapping that is set; one without rules if none is. Raises `UsageError`."""
    if settings.ros_mapping is None:
        return mapping.parse("", "no mapping (HANDOVER_ROS_MAPPING)")
    return mapping.load(settings.ros_mapping)


def _add_rules(app: FastAPI, at: _At, settings: BridgeSettings) -> None:
    @app.get("/rules", tags=["rules"])
    async def rules() -> Sequence[RuleView]:
        """Return every rule with its rates, last value and last error."""
        return at.the_bridge().views()

    @app.get("/rules/{rule}", tags=["rules"])
    async def one_rule(rule: str) -> RuleView:
        """Return a rule with its rates, last value and last error."""
        return at.the_bridge().view(rule)

    @app.post("/rules/{rule}/enable", tags=["rules"])
    async def enable(rule: str) -> RuleView:
        """Switch a rule on; it stays on when the bridge starts again."""
        await at.the_bridge().switch(rule, on=True)
        return at.the_bridge().view(rule)

    @app.post("/rules/{rule}/disable", tags=["rules"])
    async def disable(rule: str) -> RuleView:
        """Switch a rule off; it stays off when the bridge starts again."""
        await at.the_bridge().switch(rule, on=False)
        return at.the_bridge().view(rule)

    @app.get("/graph", tags=["graph"])
    async def graph() -> dict[str, Any]:
        """Return what is on the ROS graph now."""
        by_dds = settings.ros_adapter != "rosbridge"
        return {
            "domain": settings.ros_domain_id if by_dds else None,
            **graph_view.of(at.the_bridge().graph),
        }

    @app.get("/broker", tags=["graph"])
    async def broker_link() -> dict[str, Any]:
        """Return how the link to the broker is: what waits for it, and whether it is away."""
        bridge = at.the_bridge()
        return {
            "url": bridge.broker.url,
            "away": bridge.mailroom.away_since_s is not None,
            "waiting": len(bridge.mailroom.outbox),
            "subscribed": bridge.listeners.subscribed,
        }

    @app.post("/notifications/{rule}", status_code=204, tags=["notifications"])
    async def notify(rule: str, request: Request) -> Response:
        """Read the entities that have changed from the broker, and have a rule act on what that says."""
        listeners = at.the_bridge().listeners
        await listeners.take_notification(rule, request)
        return Response(status_code=204)
