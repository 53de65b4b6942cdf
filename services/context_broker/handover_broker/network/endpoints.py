"""Endpoints that clients name: checked while the client waits, and again when they are used."""

import asyncio
from typing import Final
from urllib.parse import urlsplit

from handover.network.outbound_policy import AddressRefused, OutboundPolicy
from handover_broker.model.problems import bad_request_data

LOOKUP_TIMEOUT_S: Final = 1.0
"""Timeout for resolving a name while a client waits for the response; it is resolved again when used."""

_PORTS: Final = {"https": 443, "mqtt": 1883, "mqtts": 8883}


async def require_allowed(policy: OutboundPolicy, uri: str, what: str) -> None:
    """Raise a problem (400) if the host of `uri` is refused; a name that does not resolve yet is allowed."""
    parts = urlsplit(uri)
    try:
        async with asyncio.timeout(LOOKUP_TIMEOUT_S):
            await policy.resolved(parts.hostname or "", parts.port or _PORTS.get(parts.scheme, 80))
    except AddressRefused as refused:
        raise bad_request_data(f"{what}: {refused}") from None
    except (OSError, TimeoutError, UnicodeError):
        return
