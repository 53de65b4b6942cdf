"""The ROS graph over an installed ROS, by rclpy."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from handover_ros.errors import GraphError, UnknownType
from handover_ros.graph import names
from handover_ros.graph.base_graph import BaseGraph
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.own_goals import OwnGoals
from handover_ros.graph.peer_problems import topic_problems
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
from handover_ros.graph.ros_installed import view
from handover_ros.graph.ros_installed.actions import RosActionClient, RosActionServer
from handover_ros.graph.ros_installed.own_node import OwnRosNode, hash_of, interface
from handover_ros.graph.ros_installed.services import RosClient, RosServer
from handover_ros.graph.ros_installed.topics import RosPublisher, RosSubscription
from handover_ros.types.type_store import TypeStore


class RosInstalledGraph(BaseGraph):
    """A node on the graph; see `port.RosGraph`. Created by `joining.join`."""

    def __init__(
        self, store: TypeStore, settings: JoinSettings, node: OwnRosNode, goals: OwnGoals | None = None
    ) -> None:
        super().__init__(store, settings)
        if goals is not None:
            self.goals = goals
        else:
            self.goals.graph = self
        self._owns_goals = goals is None
        self._node = node
        self._clients: dict[tuple[str, str], RosClient] = {}

    @property
    def middleware(self) -> str:
        """Return the RMW implementation, `rmw_fastrtps_cpp`."""
        return str(self._node.vendor)

    @classmethod
    async def join(
        cls, store: TypeStore, settings: JoinSettings, *, goals: OwnGoals | None = None
    ) -> "RosInstalledGraph":
        """Join the graph; with the `goals` of another graph, that one cancels what is given up.

        Raises:
            BadName: the node or its namespace has an invalid name.
            AdapterUnavailable: the installed ROS does not start.
        """
        names.node_name(settings.node)
        names.namespace(settings.namespace)
        made = cls(store, settings, await asyncio.to_thread(OwnRosNode, settings, store), goals)
        try:
            if goals is None:
                await made.goals.open()
        except BaseException:
            await made.close()
            raise
        return made

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> RosSubscription:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosSubscription(
            self._node,
            name,
            full,
            qos,
            on_message=on_message,
            max_message_bytes=self._settings.max_message_bytes,
            closed=self._unregister,
        )
        self._register(opened)
        await self._checked(opened, self._node.node.get_subscriptions_info_by_topic)
        return opened

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> RosPublisher:
        name, full = self._full(topic), self._type(type_name, "msg", "")
        opened = RosPublisher(
            self._node,
            name,
            full,
            qos,
            max_message_bytes=self._settings.max_message_bytes,
            closed=self._unregister,
        )
        self._register(opened)
        await self._checked(opened, self._node.node.get_publishers_info_by_topic)
        return opened

    async def _checked(self, opened: Any, ends: Callable[[str], Any]) -> None:
        """Close the topic and raise if the installed ROS has another definition of its type."""
        for end in ends(opened.topic):
            if view.full_name(end) == self.node_name and end.topic_type == opened.type_name:
                try:
                    self._node.same(opened.topic, opened.type_name, hash_of(end))
                except GraphError:
                    await opened.close()
                    raise

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        key = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        if key not in self._clients:
            self._clients[key] = RosClient(self._node, *key)
        return await self._clients[key].call(request, timeout_s)

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> RosServer:
        name, full = self._full(service), self._type(type_name, "srv", "_Request", "_Response")
        opened = RosServer(self._node, name, full, handler, closed=self._unregister)
        self._register(opened)
        return opened

    async def action_client(self, action: str, type_name: str) -> RosActionClient:
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        await self.goals.watch(name)
        opened = RosActionClient(self._node, name, full, own=self.goals, closed=self._unregister)
        self._register(opened)
        return opened

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> RosActionServer:
        name, full = self._full(action), self._type(type_name, "action", "_Goal", "_Result", "_Feedback")
        opened = RosActionServer(self._node, name, full, handler, accept=accept, closed=self._unregister)
        self._register(opened)
        return opened

    def topics(self) -> Sequence[TopicInfo]:
        return view.topics(self._node.node, self.node_name)

    def services(self) -> Sequence[ServiceInfo]:
        return view.services(self._node.node, self._node.vendor)

    def actions(self) -> Sequence[ActionInfo]:
        return view.actions(self._node.node)

    def nodes(self) -> Sequence[NodeInfo]:
        return view.nodes(self._node.node, self.node_name, self._node.vendor)

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:  # noqa: ARG002 - see the port
        """Return why calls of a service would fail; rclpy does not report the hashes of servers."""
        return missing_type(type_name, self.store)

    def problems(self) -> Sequence[GraphError]:
        return topic_problems(self.topics())

    async def close(self) -> None:
        if self._closed:
            return
        if self._owns_goals:
            await self.goals.close()
        self._closed = True
        await self._close_all()
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        await asyncio.to_thread(self._node.close)


def missing_type(type_name: str, store: TypeStore) -> list[GraphError]:
    """Return why rclpy cannot call a service `X` or `X_SendGoal`; empty if it can."""
    try:
        interface(type_name.removesuffix("_SendGoal"), store)
    except UnknownType as error:
        return [error]
    return []
