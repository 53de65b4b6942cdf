"""The errors of the broker client."""

from handover.errors import Problem


class BrokerError(Problem):
    """The broker refused the request with `status`, `title` and `detail`."""


class NotFound(BrokerError):
    """There is no such entity, attribute or subscription."""


class AlreadyExists(BrokerError):
    """An entity or subscription with this id exists."""


class BrokerUnavailable(BrokerError):
    """The broker is unreachable or cannot answer now; a retry may succeed."""


class BrokerUnreachable(BrokerUnavailable):
    """No answer came."""


class BrokerFault(BrokerUnavailable):
    """The broker failed at the request, as with 500; a retry may succeed, or never."""
