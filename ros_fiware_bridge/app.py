"""The face of the ROS bridge: its rules with their rates, last values and errors, and the live graph."""

import secrets
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI, Request, Response
from httpx_aiohttp import AiohttpTransport

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.notifications import notified_entities
from handover.service import create_app
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
            raise Problem(503, "Not ready", "the ROS bridge is starting; try again in a moment")
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
            bridge = Bridge(made, graph, broker, settings, url=settings.url, name=settings.bridge_name)
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
        checks={"broker": broker.probe, "subscriptions": subscribed},
    )
    _add_rules(app, at)
    return app


def read_mapping(settings: BridgeSettings) -> Document:
    """Return the mapping that is set; one without rules if none is. Raises `UsageError`."""
    if settings.ros_mapping is None:
        return mapping.parse("", "no mapping (HANDOVER_ROS_MAPPING)")
    return mapping.load(settings.ros_mapping)


def _add_rules(app: FastAPI, at: _At) -> None:
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
        return graph_view.of(at.the_bridge().graph)

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

    @app.post("/notifications/{key}/{rule}", status_code=204, tags=["notifications"])
    async def notify(key: str, rule: str, request: Request) -> Response:
        """Take notice of entities that changed; `key` is known to those who can read our subscriptions."""
        bridge = at.the_bridge()
        listener = bridge.listeners.named(rule)
        if listener is None or not secrets.compare_digest(key.encode(), bridge.key.encode()):
            raise Problem(404, "No such rule", f'no rule "{rule}" listens to the broker at this address')
        entities = await notified_entities(request)
        for entity in entities:
            listener.take(entity)
        return Response(status_code=204)
