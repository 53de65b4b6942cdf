"""The graph as the server's rosapi tells of it, asked every few seconds: it sends no news by itself.

All clients of a server are one node of the graph, the server's own, so what is ours cannot be told apart.
"""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from ros_fiware_bridge.errors import CallTimeout, GraphError
from ros_fiware_bridge.graph.port import ActionInfo, Endpoint, NodeInfo, ServiceInfo, TopicInfo
from ros_fiware_bridge.graph.qos import DEFAULT
from ros_fiware_bridge.graph.rosbridge.link import Link
from ros_fiware_bridge.types.type_store import TypeStore

LOOK_EVERY_S, LOOK_SOON_S = 3.0, 0.25
PATIENCE_S = 3.0
MOST_NODES = 300
VENDOR = "rosbridge"
_OF_ACTIONS = "/_action/"


class RosapiView:
    """Who is on the graph, as it was told last."""

    def __init__(self, link: Link, store: TypeStore) -> None:
        self._link = link
        self._store = store
        self._types: dict[str, str] = {}
        self._nodes: dict[str, Mapping[str, Sequence[str]]] = {}
        self._service_types: dict[str, str] = {}
        self._soon = asyncio.Event()
        self.fault: str | None = None

    async def keep(self) -> None:
        """Look round until cancelled."""
        while True:
            self._soon.clear()
            if self._link.is_open:
                with suppress(GraphError):
                    await self.look()
            with suppress(TimeoutError):
                async with asyncio.timeout(LOOK_EVERY_S):
                    await self._soon.wait()
                await asyncio.sleep(LOOK_SOON_S)

    def look_now(self) -> None:
        """Have it looked round soon, because somebody waits."""
        self._soon.set()

    async def look(self) -> None:
        """Look round once. Raises `GraphError`."""
        try:
            topics = await self.ask("topics")
            nodes = (await self.ask("nodes")).get("nodes", ())
            found = {name: await self.ask("node_details", node=name) for name in list(nodes)[:MOST_NODES]}
            offered = {one for details in found.values() for one in details.get("services", ())}
            for service in sorted(offered - self._service_types.keys()):
                if _OF_ACTIONS not in service and not service.startswith("/rosapi/"):
                    self._service_types[service] = str(
                        (await self.ask("service_type", service=service))["type"]
                    )
        except GraphError as error:
            self.fault = str(error)
            raise
        self._types = dict(zip(topics.get("topics", ()), topics.get("types", ()), strict=False))
        self._nodes = found
        self.fault = None

    async def ask(self, what: str, /, **asked: Any) -> Mapping[str, Any]:
        """Ask the server's rosapi. Raises `GraphError`."""
        try:
            answer = await self._link.ask(
                PATIENCE_S,
                op="call_service",
                id=self._link.new_id(f"rosapi:{what}"),
                service=f"/rosapi/{what}",
                args=asked,
            )
        except TimeoutError:
            raise CallTimeout(f"rosapi of {self._link.url} did not answer within {PATIENCE_S:g} s") from None
        values = answer.get("values")
        if answer.get("result") is False or not isinstance(values, Mapping):
            raise GraphError(f"rosapi of {self._link.url} does not tell of {what}: {str(values)[:200]}")
        return values

    @property
    def is_ros1(self) -> bool:
        """Say whether the types are those of ROS 1, which are written without their kind."""
        return bool(self._types) and all(one.count("/") == 1 for one in self._types.values())

    def publishers(self, topic: str) -> int:
        """Return how many nodes publish `topic`."""
        return sum(topic in details.get("publishing", ()) for details in self._nodes.values())

    def subscribers(self, topic: str) -> int:
        """Return how many nodes listen to `topic`."""
        return sum(topic in details.get("subscribing", ()) for details in self._nodes.values())

    def topics(self) -> Sequence[TopicInfo]:
        """Return the topics by name."""
        return [
            TopicInfo(
                name,
                (self._full(told),),
                tuple(self._ends(name, told, "publishing")),
                tuple(self._ends(name, told, "subscribing")),
            )
            for name, told in sorted(self._types.items())
            if _OF_ACTIONS not in name
        ]

    def services(self) -> Sequence[ServiceInfo]:
        """Return the services by name."""
        return [
            ServiceInfo(name, (self._full(told, "srv"),), self._servers(name), (), (VENDOR,))
            for name, told in sorted(self._service_types.items())
            if self._servers(name)
        ]

    def actions(self) -> Sequence[ActionInfo]:
        """Return the actions by name: those whose feedback is a topic of the graph."""
        ending, part = f"{_OF_ACTIONS}feedback", "_FeedbackMessage"
        return [
            ActionInfo(
                name.removesuffix(ending),
                (told.removesuffix(part),),
                tuple(one.node for one in self._ends(name, told, "publishing")),
                tuple(one.node for one in self._ends(name, told, "subscribing")),
            )
            for name, told in sorted(self._types.items())
            if name.endswith(ending) and told.endswith(part)
        ]

    def nodes(self) -> Sequence[NodeInfo]:
        """Return the nodes by name."""
        parts = ((name.rpartition("/")) for name in sorted(self._nodes))
        return [NodeInfo(name, space or "/", "/", VENDOR, ours=False) for space, _, name in parts]

    def problems(self) -> Sequence[GraphError]:
        """Return what stands between us and the graph."""
        away = [] if self._link.is_open else [f"the rosbridge server at {self._link.url} is away"]
        return [GraphError(one) for one in (*away, self.fault) if one]

    def _ends(self, topic: str, told: str, role: str) -> list[Endpoint]:
        return [
            Endpoint(node, self._full(told), DEFAULT, None, VENDOR, ours=False)
            for node, details in sorted(self._nodes.items())
            if topic in details.get(role, ())
        ]

    def _servers(self, service: str) -> tuple[str, ...]:
        return tuple(
            node for node, details in sorted(self._nodes.items()) if service in details.get("services", ())
        )

    def _full(self, told: str, kind: str = "msg") -> str:
        package, _, name = told.partition("/")
        return told if "/" in name else f"{package}/{kind}/{name}"
