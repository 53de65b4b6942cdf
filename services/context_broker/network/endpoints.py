"""Endpoints that clients name: checked while the client waits, and again when they are used."""

import asyncio
from typing import Final

from handover.outbound_policy import AddressRefused, OutboundPolicy
from services.context_broker.model.problems import bad_request_data

LOOKUP_TIMEOUT_S: Final = 1.0
"""Timeout for resolving a name while a client waits for the response; it is resolved again when used."""


async def require_allowed(policy: OutboundPolicy, host: str, what: str) -> None:
    """Raise a problem (400) if `host` is refused; a name that does not resolve yet is allowed."""
    try:
        async with asyncio.timeout(LOOKUP_TIMEOUT_S):
            await policy.resolved(host, 0)
    except AddressRefused as refused:
        raise bad_request_data(f"{what}: {refused}") from None
    except (OSError, TimeoutError, UnicodeError):
        return
