"""The graph as the rosapi of the server reports it, polled every few seconds: rosapi sends no notifications.

All clients of a server are one node of the graph, so our own endpoints are not recognizable.
"""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from handover_ros.errors import CallTimeout, GraphError
from handover_ros.graph.port import ActionInfo, Endpoint, NodeInfo, ServiceInfo, TopicInfo
from handover_ros.graph.qos import DEFAULT
from handover_ros.graph.rosbridge.connection import Connection
from handover_ros.types.type_store import TypeStore

POLL_INTERVAL_S, POLL_SOON_S = 3.0, 0.25
CALL_TIMEOUT_S = 3.0
MAX_NODES = 300
VENDOR = "rosbridge"
_OF_ACTIONS = "/_action/"


class RosapiView:
    """The nodes, topics and services of the last poll."""

    def __init__(self, connection: Connection, store: TypeStore) -> None:
        self._connection = connection
        self._store = store
        self._types: dict[str, str] = {}
        self._nodes: dict[str, Mapping[str, Sequence[str]]] = {}
        self._service_types: dict[str, str] = {}
        self._soon = asyncio.Event()
        self.fault: str | None = None

    async def run(self) -> None:
        """Poll until cancelled."""
        while True:
            self._soon.clear()
            if self._connection.is_open:
                with suppress(GraphError):
                    await self.poll()
            with suppress(TimeoutError):
                async with asyncio.timeout(POLL_INTERVAL_S):
                    await self._soon.wait()
                await asyncio.sleep(POLL_SOON_S)

    def poll_soon(self) -> None:
        """Poll again soon, because a caller waits."""
        self._soon.set()

    async def poll(self) -> None:
        """Poll once. Raises `GraphError`."""
        try:
            topics = await self.call("topics")
            nodes = (await self.call("nodes")).get("nodes", ())
            details_of = {
                name: await self.call("node_details", node=name) for name in list(nodes)[:MAX_NODES]
            }
            offered = {
                offered_service
                for details in details_of.values()
                for offered_service in details.get("services", ())
            }
            for service in sorted(offered - self._service_types.keys()):
                if _OF_ACTIONS not in service and not service.startswith("/rosapi/"):
                    self._service_types[service] = str(
                        (await self.call("service_type", service=service))["type"]
                    )
        except GraphError as error:
            self.fault = str(error)
            raise
        self._types = dict(zip(topics.get("topics", ()), topics.get("types", ()), strict=False))
        self._nodes = details_of
        self.fault = None

    async def call(self, what: str, /, **asked: Any) -> Mapping[str, Any]:
        """Call a service of rosapi. Raises `GraphError`."""
        try:
            answer = await self._connection.request(
                CALL_TIMEOUT_S,
                op="call_service",
                id=self._connection.new_id(f"rosapi:{what}"),
                service=f"/rosapi/{what}",
                args=asked,
            )
        except TimeoutError:
            raise CallTimeout(
                f"rosapi of {self._connection.url} did not answer within {CALL_TIMEOUT_S:g} s"
            ) from None
        values = answer.get("values")
        if answer.get("result") is False or not isinstance(values, Mapping):
            raise GraphError(f"rosapi of {self._connection.url} failed to answer {what}: {str(values)[:200]}")
        return values

    @property
    def is_ros1(self) -> bool:
        """Return whether the types are those of ROS 1, which have no kind in their names."""
        return bool(self._types) and all(service.count("/") == 1 for service in self._types.values())

    def publishers(self, topic: str) -> int:
        """Return how many nodes publish `topic`."""
        return sum(topic in details.get("publishing", ()) for details in self._nodes.values())

    def subscribers(self, topic: str) -> int:
        """Return how many nodes subscribe to `topic`."""
        return sum(topic in details.get("subscribing", ()) for details in self._nodes.values())

    def topics(self) -> Sequence[TopicInfo]:
        """Return the topics by name."""
        return [
            TopicInfo(
                name,
                (self._full_type(type_name),),
                tuple(self._ends(name, type_name, "publishing")),
                tuple(self._ends(name, type_name, "subscribing")),
            )
            for name, type_name in sorted(self._types.items())
            if _OF_ACTIONS not in name
        ]

    def services(self) -> Sequence[ServiceInfo]:
        """Return the services by name."""
        return [
            ServiceInfo(name, (self._full_type(type_name, "srv"),), self._servers(name), (), (VENDOR,))
            for name, type_name in sorted(self._service_types.items())
            if self._servers(name)
        ]

    def actions(self) -> Sequence[ActionInfo]:
        """Return the actions by name: those with a feedback topic on the graph."""
        ending, part = f"{_OF_ACTIONS}feedback", "_FeedbackMessage"
        return [
            ActionInfo(
                name.removesuffix(ending),
                (type_name.removesuffix(part),),
                tuple(end.node for end in self._ends(name, type_name, "publishing")),
                tuple(end.node for end in self._ends(name, type_name, "subscribing")),
            )
            for name, type_name in sorted(self._types.items())
            if name.endswith(ending) and type_name.endswith(part)
        ]

    def nodes(self) -> Sequence[NodeInfo]:
        """Return the nodes by name."""
        parts = ((name.rpartition("/")) for name in sorted(self._nodes))
        return [NodeInfo(name, space or "/", "/", VENDOR, ours=False) for space, _, name in parts]

    def problems(self) -> Sequence[GraphError]:
        """Return the present problems of the connection."""
        away = (
            []
            if self._connection.is_open
            else [f"the rosbridge server at {self._connection.url} is unavailable"]
        )
        return [GraphError(fault) for fault in (*away, self.fault) if fault]

    def _ends(self, topic: str, type_name: str, role: str) -> list[Endpoint]:
        return [
            Endpoint(node, self._full_type(type_name), DEFAULT, None, VENDOR, ours=False)
            for node, details in sorted(self._nodes.items())
            if topic in details.get(role, ())
        ]

    def _servers(self, service: str) -> tuple[str, ...]:
        return tuple(
            node for node, details in sorted(self._nodes.items()) if service in details.get("services", ())
        )

    def _full_type(self, type_name: str, kind: str = "msg") -> str:
        package, _, name = type_name.partition("/")
        return type_name if "/" in name else f"{package}/{kind}/{name}"
