"""The ROS graph over a rosbridge server, as far as the protocol supports the port."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress

from handover_ros.errors import GraphError
from handover_ros.graph import names
from handover_ros.graph.base_graph import BaseGraph
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
from handover_ros.graph.rosbridge import services
from handover_ros.graph.rosbridge.actions import RosbridgeActionClient, RosbridgeActionServer
from handover_ros.graph.rosbridge.connection import Connection
from handover_ros.graph.rosbridge.json_codec import JsonCodec
from handover_ros.graph.rosbridge.services import RosbridgeServer
from handover_ros.graph.rosbridge.topics import RosbridgePublisher, RosbridgeSubscription, TopicContext
from handover_ros.graph.rosbridge.view import RosapiView
from handover_ros.types.type_store import TypeStore


class RosbridgeGraph(BaseGraph):
    """A client of a rosbridge server; see `port.RosGraph`. Created by `joining.join`."""

    def __init__(self, store: TypeStore, settings: JoinSettings, connection: Connection) -> None:
        super().__init__(store, settings)
        self._connection = connection
        self._codec = JsonCodec(store)
        self._view = RosapiView(connection, store)
        self._topic_context = TopicContext(connection, self._codec, self._view, settings.max_message_bytes)
        self._polling: asyncio.Task[None] | None = None

    @classmethod
    async def join(cls, store: TypeStore, settings: JoinSettings) -> "RosbridgeGraph":
        """Join the graph.

        Raises:
            BadName: the node or its namespace has an invalid name.
            AdapterUnavailable: the server does not answer.
        """
        names.node_name(settings.node)
        names.namespace(settings.namespace)
        connection = Connection(settings.rosbridge_url, settings.max_message_bytes)
        await connection.open()
        made = cls(store, settings, connection)
        await made.begin()
        return made

    async def begin(self) -> None:
        """Determine the ROS version, and start polling the graph."""
        with suppress(GraphError):  # messages work without rosapi
            await self._view.poll()
        self._codec.ros1 = self._view.is_ros1
        self._polling = asyncio.create_task(self._view.run())

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> RosbridgeSubscription:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosbridgeSubscription(
            self._topic_context,
            name,
            full,
            qos,
            on_message=on_message,
            closed=self._unregister,
        )
        self._register(opened)
        return opened

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> RosbridgePublisher:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosbridgePublisher(
            self._topic_context,
            name,
            full,
            qos,
            closed=self._unregister,
        )
        self._register(opened)
        return opened

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        name, full = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        return await services.call(self._connection, self._codec, name, full, request, timeout_s=timeout_s)

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> RosbridgeServer:
        name, full = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        opened = RosbridgeServer(self._connection, self._codec, name, full, handler, closed=self._unregister)
        self._register(opened)
        return opened

    async def action_client(self, action: str, type_name: str) -> RosbridgeActionClient:
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        opened = RosbridgeActionClient(
            self._connection, self._codec, self._view, name, full, closed=self._unregister
        )
        self._register(opened)
        return opened

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> RosbridgeActionServer:
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        opened = RosbridgeActionServer(
            self._connection, self._codec, name, full, handler, accept=accept, closed=self._unregister
        )
        self._register(opened)
        return opened

    def topics(self) -> Sequence[TopicInfo]:
        return self._view.topics()

    def services(self) -> Sequence[ServiceInfo]:
        return self._view.services()

    def actions(self) -> Sequence[ActionInfo]:
        return self._view.actions()

    def nodes(self) -> Sequence[NodeInfo]:
        return self._view.nodes()

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:  # noqa: ARG002 - see the port
        """Return nothing: a rosbridge server reports neither middlewares nor hashes."""
        return []

    def problems(self) -> Sequence[GraphError]:
        """Return the present problems of the connection."""
        return self._view.problems()

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._polling is not None:
            self._polling.cancel()
            with suppress(asyncio.CancelledError):
                await self._polling
        await self._close_all()
        await self._connection.close()
