"""The context broker: its client, who it is, what it can do."""

from handover.broker.client import (
    JSON_LD,
    MAX_FAULTS,
    AlreadyExists,
    BrokerClient,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    BrokerUnreachable,
    Credentials,
    NgsiLd,
    NotFound,
    fault_delay_s,
    is_presence,
)

__all__ = [
    "JSON_LD",
    "MAX_FAULTS",
    "AlreadyExists",
    "BrokerClient",
    "BrokerError",
    "BrokerFault",
    "BrokerUnavailable",
    "BrokerUnreachable",
    "Credentials",
    "NgsiLd",
    "NotFound",
    "fault_delay_s",
    "is_presence",
]
