"""The port to a ROS graph: topics, services and actions, with messages as plain dicts.

A message is a dict with the field names of its definition, all of them, at every depth. Numbers, text and
booleans are Python's; `uint8[]`, `byte[]` and `char[]` are bytes; other arrays of numbers or booleans arrive
as NumPy arrays that cannot be written to; arrays of text or of messages are lists; a time or duration is
`{"sec": …, "nanosec": …}`. What is sent may leave fields out (they take the definition's default) and may
give any array as a list.

All of it is used from the asyncio loop that opened the graph, and every callback runs there.
"""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

from handover_ros.errors import GraphError
from handover_ros.graph.qos import DEFAULT, Qos
from handover_ros.types.excerpt import FieldNames

Message = dict[str, Any]
ServiceHandler = Callable[[Message], Awaitable[Message]]


class Received(Protocol):
    """A received message. It is decoded on first access, so that an ignored message costs little."""

    topic: str
    type_name: str
    received_at_s: float
    """When it was taken from the network, in seconds since 1970 (UTC)."""
    sent_at_s: float | None
    """When its sender passed it to the network, by the sender's clock; None if that is not reported."""
    ours: bool | None
    """Whether a publisher of this graph object sent it; None where the adapter cannot know."""

    @property
    def size_bytes(self) -> int:
        """How long it is on the wire."""

    @property
    def message(self) -> Message:
        """The whole message.

        Raises:
            BadMessage: what came is not a message of this type.
        """

    def excerpt(self, fields: frozenset[FieldNames]) -> Message:
        """Return the message with those fields, `("header", "stamp")`, and perhaps others; `()` is all of it.

        Raises:
            BadMessage: what came is not a message of this type.
        """


OnMessage = Callable[[Received], None]


class Subscription(Protocol):
    """A subscription to a topic, until `close`."""

    topic: str
    type_name: str
    qos: Qos
    received: int
    """How many messages have come."""
    dropped: int
    """How many were replaced by newer ones before the loop processed them (`depth` are kept)."""
    refused: int
    """How many could not be read, or came from a peer with another definition."""
    last_error: str | None

    def publishers(self) -> int:
        """Return how many publishers are matched at the moment."""

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a publisher is matched; False if none came in time."""

    async def close(self) -> None:
        """Unsubscribe. Closing twice is harmless."""


class Publisher(Protocol):
    """A publisher on a topic, until `close`."""

    topic: str
    type_name: str
    qos: Qos
    published: int

    def publish(self, message: Message) -> None:
        """Send `message`; what it leaves out takes the definition's default.

        Raises:
            BadMessage: a field that is unknown, of another type, out of range or over its bound.
            MessageTooBig: the message is bigger than the graph's limit.
            PublishBlocked: reliable readers are too slow to take it.
        """

    def subscribers(self) -> int:
        """Return how many subscribers are matched at the moment."""

    async def matched(self, timeout_s: float) -> bool:
        """Wait until a subscriber is matched; False if none came in time."""

    async def close(self) -> None:
        """Stop publishing. Closing twice is harmless."""


class Served(Protocol):
    """A service or an action that is offered, until `close`."""

    name: str
    type_name: str

    @property
    def calls(self) -> int:
        """How many requests or goals came."""

    @property
    def failed(self) -> int:
        """How many of them failed."""

    @property
    def last_error(self) -> str | None:
        """Why the last one failed."""

    async def close(self) -> None:
        """Stop serving; pending calls are not answered. Closing twice is harmless."""


class GoalStatus(IntEnum):
    """The state of a goal (`action_msgs/msg/GoalStatus`)."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def is_over(self) -> bool:
        """Whether a goal stays so."""
        return self >= GoalStatus.SUCCEEDED


@dataclass(frozen=True, slots=True)
class GoalResult:
    """How a goal ended, and the action's result message."""

    status: GoalStatus
    result: Message


class Goal(Protocol):
    """A goal that an action server has accepted."""

    goal_id: bytes
    """16 bytes."""

    @property
    def status(self) -> GoalStatus:
        """The state of the goal, as last reported."""

    async def result(self, timeout_s: float | None = None) -> GoalResult:
        """Wait for the end of the goal; None waits as long as it takes.

        Raises:
            CallTimeout: it did not end in time; the goal continues and the result may be requested again.
            ServerLost: the server that accepted it went away, or was started again.
        """

    async def cancel(self, timeout_s: float = 5.0) -> bool:
        """Ask the server to cancel; True if it agreed (the result then says whether it did).

        Raises:
            CallTimeout, ServerLost, ServiceUnavailable: the server did not answer.
        """


class ActionClient(Protocol):
    """An action that goals are sent to, until `close`."""

    name: str
    type_name: str

    async def available(self, timeout_s: float) -> bool:
        """Wait until a server of the action is available; False if none was found in time."""

    async def send_goal(
        self, goal: Message, *, on_feedback: Callable[[Message], None] | None = None, timeout_s: float = 5.0
    ) -> Goal:
        """Send a goal and wait until it is accepted.

        A goal whose sender gives up, by an error or a cancellation, is cancelled, also if it is accepted
        later.

        Raises:
            BadMessage: the goal does not fit the definition.
            GoalRefused: the server rejects it.
            ServiceUnavailable: there is no server; nothing was sent.
            OutcomeUnknown: it was sent, and no server answered (`CallTimeout`, `ServerLost`).
        """

    async def close(self) -> None:
        """Release the action; goals that have not ended are cancelled. Closing twice is harmless."""


class ServedGoal(Protocol):
    """A goal that is being worked on by a handler of ours."""

    goal_id: bytes
    request: Message

    def feedback(self, feedback: Message) -> None:
        """Send feedback to the client of the goal."""

    @property
    def cancel_requested(self) -> bool:
        """Whether the client asked to cancel."""

    async def wait_cancel_requested(self) -> None:
        """Wait until the client asks to cancel."""


class GoalEnded(Exception):
    """Raised by an action handler to end a goal other than by success; `result` is the result message."""

    def __init__(self, status: GoalStatus, result: Message | None = None) -> None:
        super().__init__(status.name)
        self.status = status
        self.result: Message = result or {}


ActionHandler = Callable[[ServedGoal], Awaitable[Message]]
"""Works on a goal and returns the result message; raises `GoalEnded` with ABORTED or CANCELED otherwise."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One publisher or subscriber of a topic, as it made itself known.

    DDS does not transmit history and depth; `qos` has their defaults.
    """

    node: str | None
    """The full name of its node, `/robot/driver`; None until its participant has announced it."""
    type_name: str
    qos: Qos
    type_hash: str | None
    """`RIHS01_…`; None if the peer does not publish it."""
    vendor: str
    """The middleware, `cyclonedds`, `fastdds` or another."""
    ours: bool

    @property
    def shown_node(self) -> str:
        """Return the name of its node for people."""
        return self.node or f"a node without a name yet ({self.vendor})"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of the graph; more than one type is a fault of the graph that is shown, not hidden."""

    name: str
    type_names: tuple[str, ...]
    publishers: tuple[Endpoint, ...]
    subscribers: tuple[Endpoint, ...]


@dataclass(frozen=True, slots=True)
class ServiceInfo:
    """A service of the graph, with the full names of the nodes that serve and call it."""

    name: str
    type_names: tuple[str, ...]
    servers: tuple[str | None, ...]
    clients: tuple[str | None, ...]
    vendors: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ActionInfo:
    """An action of the graph; `type_names` such as `control_msgs/action/FollowJointTrajectory`."""

    name: str
    type_names: tuple[str, ...]
    servers: tuple[str | None, ...]
    clients: tuple[str | None, ...]


@dataclass(frozen=True, slots=True)
class NodeInfo:
    """A node of the graph."""

    name: str
    namespace: str
    enclave: str
    vendor: str
    ours: bool

    @property
    def full_name(self) -> str:
        """The name with its namespace, `/robot/driver`."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


class RosGraph(Protocol):
    """A ROS graph that we are a node of. Names may be relative to our namespace (`joint_states`)."""

    node_name: str
    """Our own full name, `/handover_bridge`."""

    async def subscribe(
        self, topic: str, type_name: str, on_message: OnMessage, qos: Qos = DEFAULT
    ) -> Subscription:
        """Subscribe to a topic; `type_name` such as `sensor_msgs/msg/JointState`.

        An exception of `on_message` is counted and logged; the subscription continues.

        Raises:
            UnknownType, UnsupportedType, BadName.
        """

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        """Publish on a topic.

        Raises:
            UnknownType, UnsupportedType, BadName.
        """

    async def call(self, service: str, type_name: str, request: Message, timeout_s: float = 5.0) -> Message:
        """Call a service and return its response; `timeout_s` includes waiting for the server to be found.

        Raises:
            UnknownType, UnsupportedType, BadName, BadMessage, VendorNotShared, TypeHashDiffers.
            ServiceUnavailable: no server was found within the time; nothing was sent.
            OutcomeUnknown: it was sent and not answered (`CallTimeout`, `ServerLost`), or not legibly.
        """

    async def serve(self, service: str, type_name: str, handler: ServiceHandler) -> Served:
        """Serve a service. A handler that raises leaves its caller unanswered; it is counted and logged.

        Raises:
            UnknownType, UnsupportedType, BadName.
        """

    async def action_client(self, action: str, type_name: str) -> ActionClient:
        """Send goals to an action; `type_name` such as `example_interfaces/action/Fibonacci`.

        Raises:
            UnknownType, UnsupportedType, BadName.
        """

    async def serve_action(
        self,
        action: str,
        type_name: str,
        handler: ActionHandler,
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> Served:
        """Serve an action; `accept` decides on each goal (without it all are accepted).

        Raises:
            UnknownType, UnsupportedType, BadName.
        """

    def topics(self) -> Sequence[TopicInfo]:
        """Return the topics of the graph by name, without those that carry services and actions."""

    def services(self) -> Sequence[ServiceInfo]:
        """Return the services of the graph by name, without those that carry actions."""

    def actions(self) -> Sequence[ActionInfo]:
        """Return the actions of the graph by name."""

    def nodes(self) -> Sequence[NodeInfo]:
        """Return the nodes of the graph by full name."""

    def obstacles(self, service: str, type_name: str) -> Sequence[GraphError]:
        """Return why calls of a service would fail with its present servers, as far as known.

        For an action, `service` is `NAME/_action/send_goal` and `type_name` is `TYPE_SendGoal`.
        """

    def problems(self) -> Sequence[GraphError]:
        """Return the present incompatibilities with peers: different hashes, incompatible QoS."""

    async def close(self) -> None:
        """Leave the graph and close everything opened on it. Closing twice is harmless."""
