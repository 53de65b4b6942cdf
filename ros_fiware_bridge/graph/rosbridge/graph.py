"""The ROS graph by way of a rosbridge server: what the port promises, as far as the protocol can carry it."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress

from ros_fiware_bridge.errors import GraphError
from ros_fiware_bridge.graph import names
from ros_fiware_bridge.graph.joining import JoinSettings
from ros_fiware_bridge.graph.member import Member
from ros_fiware_bridge.graph.port import (
    ActionHandler,
    ActionInfo,
    Message,
    NodeInfo,
    OnMessage,
    ServiceHandler,
    ServiceInfo,
    TopicInfo,
)
from ros_fiware_bridge.graph.qos import DEFAULT, Qos
from ros_fiware_bridge.graph.rosbridge import services
from ros_fiware_bridge.graph.rosbridge.actions import RosbridgeActionClient, RosbridgeActionServer
from ros_fiware_bridge.graph.rosbridge.forms import Forms
from ros_fiware_bridge.graph.rosbridge.link import Link
from ros_fiware_bridge.graph.rosbridge.services import RosbridgeServer
from ros_fiware_bridge.graph.rosbridge.topics import Desk, RosbridgePublisher, RosbridgeSubscription
from ros_fiware_bridge.graph.rosbridge.view import RosapiView
from ros_fiware_bridge.types.type_store import TypeStore


class RosbridgeGraph(Member):
    """A client of a rosbridge server; see `port.RosGraph`. Made by `joining.join`."""

    def __init__(self, store: TypeStore, settings: JoinSettings, link: Link) -> None:
        super().__init__(store, settings)
        self._link = link
        self._forms = Forms(store)
        self._view = RosapiView(link, store)
        self._desk = Desk(link, self._forms, self._view, settings.most_bytes)
        self._looking: asyncio.Task[None] | None = None

    @classmethod
    async def join(cls, store: TypeStore, settings: JoinSettings) -> "RosbridgeGraph":
        """Join the graph.

        Raises:
            BadName: the node or its namespace cannot be called so.
            AdapterUnavailable: no server answers.
        """
        names.node_name(settings.node)
        names.namespace(settings.namespace)
        link = Link(settings.rosbridge_url, settings.most_bytes)
        await link.open()
        made = cls(store, settings, link)
        await made.begin()
        return made

    async def begin(self) -> None:
        """Learn which ROS it is, and look round from then on."""
        with suppress(GraphError):  # a server without rosapi still carries messages
            await self._view.look()
        self._forms.ros1 = self._view.is_ros1
        self._looking = asyncio.create_task(self._view.keep())

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> RosbridgeSubscription:
        """Listen to a topic."""
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosbridgeSubscription(
            self._desk,
            name,
            full,
            qos,
            on_message=on_message,
            closed=self._gone,
        )
        self._keep(opened)
        return opened

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> RosbridgePublisher:
        """Speak on a topic."""
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosbridgePublisher(
            self._desk,
            name,
            full,
            qos,
            closed=self._gone,
        )
        self._keep(opened)
        return opened

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        """Call a service."""
        name, full = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        return await services.call(self._link, self._forms, name, full, request, timeout_s=timeout_s)

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> RosbridgeServer:
        """Serve a service."""
        name, full = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        opened = RosbridgeServer(self._link, self._forms, name, full, handler, closed=self._gone)
        self._keep(opened)
        return opened

    async def action_client(self, action: str, type_name: str) -> RosbridgeActionClient:
        """Send goals to an action."""
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        opened = RosbridgeActionClient(self._link, self._forms, self._view, name, full, closed=self._gone)
        self._keep(opened)
        return opened

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> RosbridgeActionServer:
        """Serve an action."""
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        opened = RosbridgeActionServer(
            self._link, self._forms, name, full, handler, accept=accept, closed=self._gone
        )
        self._keep(opened)
        return opened

    def topics(self) -> Sequence[TopicInfo]:
        """Return the topics of the graph."""
        return self._view.topics()

    def services(self) -> Sequence[ServiceInfo]:
        """Return the services of the graph."""
        return self._view.services()

    def actions(self) -> Sequence[ActionInfo]:
        """Return the actions of the graph."""
        return self._view.actions()

    def nodes(self) -> Sequence[NodeInfo]:
        """Return the nodes of the graph."""
        return self._view.nodes()

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:  # noqa: ARG002 - see the port
        """Return nothing: a rosbridge server reveals neither middlewares nor hashes."""
        return []

    def problems(self) -> Sequence[GraphError]:
        """Return what stands between us and peers now."""
        return self._view.problems()

    async def close(self) -> None:
        """Leave the graph."""
        if self._closed:
            return
        self._closed = True
        if self._looking is not None:
            self._looking.cancel()
            with suppress(asyncio.CancelledError):
                await self._looking
        await self._close_all()
        await self._link.close()
