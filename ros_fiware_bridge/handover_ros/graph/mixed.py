"""A ROS graph over two middlewares: topics over Cyclone DDS, each service over the middleware of its peer.

Fast DDS and Cyclone DDS have compatible topics and incompatible services. So topics and discovery use our own
Cyclone DDS node (`CycloneGraph`). A service or action is called through rclpy if its server uses another
middleware than Cyclone DDS. The rclpy node starts when it is first needed.

Invariant: a service of ours is served by one side at a time. A server on Fast DDS would also read the
requests of Cyclone clients, and execute each request twice.
"""

import asyncio
import contextlib
import importlib.util
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace

import structlog

from handover_ros.errors import GraphError, VendorNotShared
from handover_ros.graph.cyclone.graph import CycloneGraph
from handover_ros.graph.cyclone.services import VENDOR
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.own_goals import OwnGoals
from handover_ros.graph.port import (
    ActionClient,
    ActionHandler,
    ActionInfo,
    Goal,
    Message,
    NodeInfo,
    OnMessage,
    Publisher,
    RosGraph,
    Served,
    ServiceHandler,
    ServiceInfo,
    Subscription,
    TopicInfo,
)
from handover_ros.graph.qos import DEFAULT, Qos
from handover_ros.graph.waiting import until
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

_POLL_INTERVAL_S = 0.5
_SEND_GOAL = "/_action/send_goal"
_MIDDLEWARE = {
    "rmw_fastrtps_cpp": "fastdds",
    "rmw_fastrtps_dynamic_cpp": "fastdds",
    "rmw_cyclonedds_cpp": VENDOR,
    "rmw_connextdds": "connext",
}
JoinRclpy = Callable[[], Awaitable[tuple[RosGraph, str]]]
"""Joins the graph through rclpy; returns it and the name of its RMW implementation."""


async def join(store: TypeStore, settings: JoinSettings) -> RosGraph:
    """Join the graph with Cyclone DDS, and with rclpy for services if it is installed; see `joining.Join`."""
    own = await CycloneGraph.join(store, settings)
    if importlib.util.find_spec("rclpy") is None:
        return own
    beside = replace(settings, node=f"{settings.node}_rclpy")
    return MixedGraph(own, lambda: _join_rclpy(store, beside, own.goals))


async def _join_rclpy(store: TypeStore, settings: JoinSettings, goals: OwnGoals) -> tuple[RosGraph, str]:
    from handover_ros.graph.ros_installed.graph import RosInstalledGraph  # noqa: PLC0415 - if needed

    graph = await RosInstalledGraph.join(store, settings, goals=goals)
    return graph, graph.middleware


class MixedGraph:
    """See `port.RosGraph`. Created by `join`; `join_rclpy` is called at most once."""

    def __init__(self, own: CycloneGraph, join_rclpy: JoinRclpy) -> None:
        self.own = own
        self.node_name = own.node_name
        own.goals.graph = self
        self._join_rclpy = join_rclpy
        self._joining: asyncio.Task[tuple[RosGraph, str]] | None = None

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> Subscription:
        return await self.own.subscribe(topic, type_name, on_message, qos)

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        return await self.own.publisher(topic, type_name, qos)

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        """Call a service through the middleware of its server."""
        clock = asyncio.get_running_loop().time
        end_s = clock() + timeout_s
        carrier = await self.carrier(service, timeout_s)
        return await carrier.call(service, type_name, request, max(0.0, end_s - clock()))

    async def carrier(self, service: str, timeout_s: float) -> RosGraph:
        """Return the graph that reaches the server of a service; our own if none is found in time.

        Raises:
            VendorNotShared: its middleware is neither Cyclone DDS nor that of rclpy.
            AdapterUnavailable: rclpy does not start.
        """
        name = self.own.full(service)
        await until(lambda: bool(self.own.server_vendors(name)), timeout_s)
        foreign = self.own.server_vendors(name) - {VENDOR}
        return await self.rclpy_for(name, foreign) if foreign else self.own

    async def rclpy_for(self, service: str, vendors: set[str]) -> RosGraph:
        """Return the graph of rclpy, which reaches peers of one of `vendors`.

        Raises:
            VendorNotShared, AdapterUnavailable: see `carrier`.
        """
        if self._joining is None or (self._joining.done() and self._joining.exception() is not None):
            self._joining = asyncio.get_running_loop().create_task(self._start_rclpy())
        graph, implementation = await asyncio.shield(self._joining)
        if _MIDDLEWARE.get(implementation) not in vendors:
            raise VendorNotShared(
                f"{service} is on {' and '.join(sorted(vendors))}, and rclpy runs {implementation}; set "
                "RMW_IMPLEMENTATION to the one of the robot"
            )
        return graph

    async def _start_rclpy(self) -> tuple[RosGraph, str]:
        graph, implementation = await self._join_rclpy()
        log.info("rclpy started for services and actions", middleware=implementation)
        return graph, implementation

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> Served:
        """Serve a service over the middleware of its clients."""
        served = _MixedServer(self, service, type_name, handler)
        await served.open()
        return served

    async def action_client(self, action: str, type_name: str) -> ActionClient:
        """Send goals to an action through the middleware of its server."""
        self.own.require_action(action, type_name)
        return _MixedActionClient(self, action, type_name)

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> Served:
        """Serve an action to clients on Cyclone DDS."""
        return await self.own.serve_action(action, type_name, handler, accept=accept)

    def topics(self) -> Sequence[TopicInfo]:
        return self.own.topics()

    def services(self) -> Sequence[ServiceInfo]:
        return self.own.services()

    def actions(self) -> Sequence[ActionInfo]:
        return self.own.actions()

    def nodes(self) -> Sequence[NodeInfo]:
        return self.own.nodes()

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:
        if self.own.server_vendors(self.own.full(service)) - {VENDOR}:
            from handover_ros.graph.ros_installed.graph import missing_type  # noqa: PLC0415 - if needed

            return missing_type(type_name, self.own.store)
        return self.own.obstacles(service, type_name)

    def problems(self) -> Sequence[GraphError]:
        return self.own.problems()

    async def close(self) -> None:
        """Leave the graph on both sides."""
        if self._joining is not None:
            with contextlib.suppress(GraphError):
                graph, _ = await self._joining
                await graph.close()
            self._joining = None
        await self.own.close()


class _MixedActionClient:
    """An action client that opens the right side once the server is known; see `port.ActionClient`."""

    def __init__(self, graph: MixedGraph, action: str, type_name: str) -> None:
        self.name = graph.own.full(action)
        self.type_name = type_name
        self._graph = graph
        self._opened: dict[int, ActionClient] = {}

    async def _client(self, timeout_s: float) -> ActionClient:
        carrier = await self._graph.carrier(f"{self.name}{_SEND_GOAL}", timeout_s)
        if id(carrier) not in self._opened:
            self._opened[id(carrier)] = await carrier.action_client(self.name, self.type_name)
        return self._opened[id(carrier)]

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server is available."""
        clock = asyncio.get_running_loop().time
        end_s = clock() + timeout_s
        client = await self._client(timeout_s)
        return await client.available(max(0.0, end_s - clock()))

    async def send_goal(
        self, goal: Message, *, on_feedback: Callable[[Message], None] | None = None, timeout_s: float = 5.0
    ) -> Goal:
        clock = asyncio.get_running_loop().time
        end_s = clock() + timeout_s
        client = await self._client(timeout_s)
        left_s = max(0.0, end_s - clock())
        return await client.send_goal(goal, on_feedback=on_feedback, timeout_s=left_s)

    async def close(self) -> None:
        """Close both sides."""
        opened, self._opened = self._opened, {}
        for client in opened.values():
            await client.close()


class _MixedServer:
    """A service that follows its clients to their middleware; see `port.Served`."""

    def __init__(self, graph: MixedGraph, service: str, type_name: str, handler: ServiceHandler) -> None:
        self.name = graph.own.full(service)
        self.type_name = type_name
        self._graph = graph
        self._handler = handler
        self._served: Served | None = None
        self._ended: list[Served] = []
        self._side: RosGraph = graph.own
        self._fault: str | None = None
        self._follow_task: asyncio.Task[None] | None = None

    @property
    def calls(self) -> int:
        """Return the number of requests."""
        return sum(client.calls for client in self._all())

    @property
    def failed(self) -> int:
        """Return the number of failed requests."""
        return sum(client.failed for client in self._all())

    @property
    def last_error(self) -> str | None:
        """Return the last error."""
        return self._fault or next(
            (client.last_error for client in reversed(self._all()) if client.last_error), None
        )

    def _all(self) -> list[Served]:
        return [*self._ended, *([self._served] if self._served is not None else [])]

    async def open(self) -> None:
        """Serve on Cyclone DDS, and follow the clients from then on."""
        self._served = await self._graph.own.serve(self.name, self.type_name, self._handler)
        self._follow_task = asyncio.create_task(self._follow())

    async def _follow(self) -> None:
        while True:
            await asyncio.sleep(_POLL_INTERVAL_S)
            vendors = self._graph.own.client_vendors(self.name)
            try:
                if vendors and VENDOR not in vendors:
                    await self._move(await self._graph.rclpy_for(self.name, vendors))
                elif VENDOR in vendors:
                    await self._move(self._graph.own)
            except (GraphError, OSError) as error:
                if self._fault != str(error):
                    log.warning("moving a service to the middleware of its client failed", error=str(error))
                self._fault = str(error)

    async def _move(self, side: RosGraph) -> None:
        if side is self._side and self._served is not None:
            return
        if self._served is not None:
            await self._served.close()
            self._ended.append(self._served)
            self._served = None
        self._side = side
        self._served = await side.serve(self.name, self.type_name, self._handler)
        self._fault = None
        log.info("service moved to the middleware of its clients", service=self.name)

    async def close(self) -> None:
        if self._follow_task is not None:
            self._follow_task.cancel()
            await asyncio.gather(self._follow_task, return_exceptions=True)
            self._follow_task = None
        if self._served is not None:
            await self._served.close()
            self._ended.append(self._served)
            self._served = None
