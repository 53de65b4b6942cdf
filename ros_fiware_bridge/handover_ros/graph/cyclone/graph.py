"""The ROS graph over Cyclone DDS, from PyPI wheels, without a ROS installation."""

import asyncio
from collections.abc import Callable, Sequence

from handover_ros.errors import GraphError
from handover_ros.graph import names
from handover_ros.graph.base_graph import BaseGraph
from handover_ros.graph.cyclone import dds_names, view
from handover_ros.graph.cyclone.action_client import CycloneActionClient
from handover_ros.graph.cyclone.action_server import CycloneActionServer
from handover_ros.graph.cyclone.domain import DomainSettings
from handover_ros.graph.cyclone.node import OwnNode
from handover_ros.graph.cyclone.service_client import CycloneClient
from handover_ros.graph.cyclone.service_server import CycloneServer
from handover_ros.graph.cyclone.services import obstacle
from handover_ros.graph.cyclone.topics import CyclonePublisher, CycloneSubscription
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.port import (
    ActionHandler,
    ActionInfo,
    Message,
    NodeInfo,
    OnMessage,
    ServiceHandler,
    ServiceInfo,
    TopicInfo,
)
from handover_ros.graph.qos import DEFAULT, Qos
from handover_ros.types.type_store import TypeStore


class CycloneGraph(BaseGraph):
    """A node on the graph; see `port.RosGraph`. Created by `joining.join`."""

    def __init__(self, store: TypeStore, settings: JoinSettings, node: OwnNode) -> None:
        super().__init__(store, settings)
        self.goals.graph = self
        self._node = node
        self._clients: dict[tuple[str, str], CycloneClient] = {}

    @classmethod
    async def join(cls, store: TypeStore, settings: JoinSettings) -> "CycloneGraph":
        """Join the graph.

        Raises:
            BadName: the node or its namespace has an invalid name.
            AdapterUnavailable: the domain cannot be opened.
        """
        name, namespace = names.node_name(settings.node), names.namespace(settings.namespace)
        network = DomainSettings(
            settings.domain_id, settings.interfaces, settings.peers, multicast=settings.multicast
        )
        node = await asyncio.to_thread(OwnNode, network, store, name, namespace, settings.enclave)
        made = cls(store, settings, node)
        try:
            await made.goals.open()
        except BaseException:
            await made.close()
            raise
        return made

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> CycloneSubscription:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = CycloneSubscription(
            self._node,
            name,
            full,
            qos,
            on_message=on_message,
            max_message_bytes=self._settings.max_message_bytes,
            closed=self._unregister,
        )
        self._register(opened)
        return opened

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> CyclonePublisher:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = CyclonePublisher(
            self._node,
            name,
            full,
            qos,
            max_message_bytes=self._settings.max_message_bytes,
            closed=self._unregister,
        )
        self._register(opened)
        return opened

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        name = self._full(service)
        base = self._type(type_name, "srv", "_Request", "_Response")
        return await self.client(name, base).call(request, timeout_s)

    def client(self, service: str, base: str) -> CycloneClient:
        """Return the client of a service, by its full name and type; it is created once."""
        key = (service, base)
        if key not in self._clients:
            self._clients[key] = CycloneClient(self._node, service, base, self._settings.max_message_bytes)
        return self._clients[key]

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> CycloneServer:
        name = self._full(service)
        return self.server(name, self._type(type_name, "srv", "_Request", "_Response"), handler)

    def server(self, service: str, base: str, handler: ServiceHandler) -> CycloneServer:
        """Serve a service, by its full name and type."""
        opened = CycloneServer(
            self._node,
            service,
            base,
            handler,
            max_message_bytes=self._settings.max_message_bytes,
            closed=self._unregister,
        )
        self._register(opened)
        return opened

    async def action_client(self, action: str, type_name: str) -> CycloneActionClient:
        name, full = self.require_action(action, type_name)
        opened = CycloneActionClient(self, name, full, self._unregister)
        self._register(opened)
        await opened.open()
        return opened

    def require_action(self, action: str, type_name: str) -> tuple[str, str]:
        """Return the full name and type of an action.

        Raises:
            UnknownType, UnsupportedType, BadName.
        """
        return self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> CycloneActionServer:
        name, full = self.require_action(action, type_name)
        opened = CycloneActionServer(self, name, full, handler, accept=accept, closed=self._unregister)
        self._register(opened)
        await opened.open()
        return opened

    def full(self, name: str) -> str:
        """Return the full name of a topic, service or action. Raises `BadName`, `GraphClosed`."""
        return self._full(name)

    def server_vendors(self, service: str) -> set[str]:
        """Return the middlewares of the servers of a service, given by its full name."""
        return self._vendors(service, writes=False)

    def client_vendors(self, service: str) -> set[str]:
        """Return the middlewares of the clients of a service, given by its full name."""
        return self._vendors(service, writes=True)

    def _vendors(self, service: str, *, writes: bool) -> set[str]:
        snapshot = self._node.discovery.snapshot()
        requests = snapshot.at(dds_names.of_request(service), writes=writes)
        return {request.vendor for request in requests}

    def topics(self) -> Sequence[TopicInfo]:
        return view.topics(self._node.discovery.snapshot())

    def services(self) -> Sequence[ServiceInfo]:
        return view.services(self._node.discovery.snapshot())

    def actions(self) -> Sequence[ActionInfo]:
        return view.actions(self._node.discovery.snapshot())

    def nodes(self) -> Sequence[NodeInfo]:
        return view.nodes(self._node.discovery.snapshot())

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:
        name, snapshot = self._full(service), self._node.discovery.snapshot()
        faults = (
            obstacle(self.store, name, type_name, endpoint, snapshot.node_of(endpoint))
            for endpoint in snapshot.at(dds_names.of_request(name), writes=False)
        )
        return [problem for problem in faults if problem is not None]

    def problems(self) -> Sequence[GraphError]:
        return view.problems(self._node.discovery.snapshot())

    async def close(self) -> None:
        if self._closed:
            return
        await self.goals.close()
        self._closed = True
        await self._close_all()
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        await asyncio.to_thread(self._node.close)
