"""The context broker: its client, who it is, what it can do."""

from handover.broker.answers import NgsiLd
from handover.broker.client import MAX_FAULTS, BrokerClient, fault_delay_s, is_presence
from handover.broker.connection import JSON_LD, Credentials
from handover.broker.errors import (
    AlreadyExists,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    BrokerUnreachable,
    NotFound,
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
