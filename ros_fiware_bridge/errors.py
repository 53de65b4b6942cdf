"""What can go wrong on a ROS graph, each said so that an integrator knows what to change."""

from handover.errors import HandoverError, UsageError


class GraphError(HandoverError):
    """The root of what goes wrong on a ROS graph; the text names the thing, the rule and the way out."""


class UnknownType(GraphError, UsageError):
    """No definition of that message, service or action type is at hand."""


class UnsupportedType(GraphError, UsageError):
    """The definition holds what cannot be carried (`wstring`, a type that contains itself)."""


class BadDefinition(GraphError, UsageError):
    """A `.msg`, `.srv` or `.action` file cannot be read, or says another thing than one read before."""


class UnknownField(GraphError, UsageError):
    """A field path names nothing in the definition."""


class UnknownQos(GraphError, UsageError):
    """A quality of service that does not exist."""


class BadName(GraphError, UsageError):
    """A topic, service, action or node name that ROS does not allow."""


class AdapterUnavailable(GraphError, UsageError):
    """The library that an adapter stands on is not installed, or cannot reach the network."""


class BadMessage(GraphError):
    """A message does not fit its definition; the text names the field path, the rule and what was found."""


class MessageTooBig(GraphError):
    """A message is bigger than the graph's limit, coming or going."""


class PublishBlocked(GraphError):
    """Readers take so slowly that the message could not be handed over in time."""


class TypeHashDiffers(GraphError):
    """A peer uses another definition of the same type."""


class IncompatibleQos(GraphError):
    """A peer's quality of service does not meet ours; both are named."""


class VendorNotShared(GraphError):
    """The peer's middleware carries services in another way than this adapter."""


class ServiceUnavailable(GraphError):
    """Nobody serves that service or action, or not in time."""


class CallTimeout(GraphError):
    """A service was called and did not answer in time."""


class GoalRefused(GraphError):
    """The action server did not accept the goal."""


class GraphClosed(GraphError):
    """The graph was closed while something was waiting on it."""
