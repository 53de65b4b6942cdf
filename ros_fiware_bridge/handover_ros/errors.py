"""The errors of the ROS graph; each text names the thing, the rule and the way out."""

from handover.errors import HandoverError, UsageError


class GraphError(HandoverError):
    """The base class of all errors of the ROS graph."""


class UnknownType(GraphError, UsageError):
    """The definition of a message, service or action type is unknown."""


class UnsupportedType(GraphError, UsageError):
    """The definition contains an unsupported type (a recursive type)."""


class BadDefinition(GraphError, UsageError):
    """A `.msg`, `.srv` or `.action` file is invalid, or contradicts another one."""


class UnknownQos(GraphError, UsageError):
    """There is no such quality of service."""


class BadName(GraphError, UsageError):
    """ROS does not allow this name of a topic, service, action or node."""


class AdapterUnavailable(GraphError, UsageError):
    """The library of an adapter is not installed, or cannot use the network."""


class BadMessage(GraphError):
    """A message does not match its definition; the text names the field path, the rule and the value."""


class MessageTooBig(GraphError):
    """A message is larger than the limit of the graph."""


class PublishBlocked(GraphError):
    """Readers are too slow, so that the message could not be sent in time."""


class TypeHashDiffers(GraphError):
    """A peer uses another definition of the same type."""


class IncompatibleQos(GraphError):
    """The quality of service of a peer is incompatible with ours; the text names both."""


class VendorNotShared(GraphError):
    """The services of the peer's middleware are incompatible with this adapter."""


class ServiceUnavailable(GraphError):
    """No server of a service or action was found in time; nothing was sent."""


class OutcomeUnknown(GraphError):
    """A request was sent, and nobody knows whether it was carried out, or will be."""


class CallTimeout(OutcomeUnknown):
    """A server did not answer in time."""


class ServerLost(OutcomeUnknown):
    """The server of a request went away, or does not know it any more, before it answered."""


class GoalRefused(GraphError):
    """The action server did not accept the goal."""


class GraphClosed(GraphError):
    """The graph was closed; nothing was sent."""


class ClosedUnanswered(GraphClosed, OutcomeUnknown):
    """The graph was closed before a server answered."""
