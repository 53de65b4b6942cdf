"""Destinations: which addresses the broker may be sent to, by whoever may make a subscription.

A subscriber's URL makes the broker knock at any door of its network. Link-local addresses (where clouds keep
their secrets) and, for a broker that others can reach, its own machine are closed unless a setting says so.
"""

import asyncio
import socket
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Final

from services.context_broker.api.problems import bad_request_data

LOOKED_UP_WITHIN_S: Final = 1.0
"""How long a name is looked up while somebody waits for the answer; it is looked up again when used."""


class Refused(Exception):
    """The destination is closed; the text names the rule and the setting."""


@dataclass(frozen=True, slots=True)
class Destinations:
    """Which kinds of special addresses are open."""

    link_local: bool = False
    loopback: bool = True

    def fault_of(self, host: str) -> str | None:
        """Return why `host`, an address, is closed; None if it is open or is a name and must be looked up."""
        address = address_of(host)
        if address is None:
            return None
        if address.is_link_local and not self.link_local:
            return (
                f"{host} is a link-local address, to which this broker sends nothing; choose another one, "
                "or allow them with HANDOVER_BROKER_NOTIFY_LINK_LOCAL=true"
            )
        if (address.is_loopback or address.is_unspecified) and not self.loopback:
            return (
                f"{host} is this broker's own machine, and one that others can reach sends nothing there; "
                "give the address at which others reach the receiver, or allow it with "
                "HANDOVER_BROKER_NOTIFY_LOOPBACK=true"
            )
        return None

    async def resolved(self, host: str, port: int) -> list[str]:
        """Return the open addresses of `host`, in the order to try them.

        Raises `Refused` when there are only closed ones, `OSError` when the name cannot be looked up.
        """
        if address_of(host) is not None:
            found = [host]
        else:
            known = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
            found = list(dict.fromkeys(str(one[4][0]) for one in known))
        faults = {one: self.fault_of(one) for one in found}
        allowed = [one for one, fault in faults.items() if fault is None]
        if not allowed:
            why = next((fault for fault in faults.values() if fault), f"{host} has no address")
            raise Refused(why if host in faults else f"{host} leads to {why}")
        return allowed

    async def require_open(self, host: str, what: str) -> None:
        """Raise a problem (400) if `host` is closed; a name that nobody knows yet may become known later."""
        try:
            async with asyncio.timeout(LOOKED_UP_WITHIN_S):
                await self.resolved(host, 0)
        except Refused as refused:
            raise bad_request_data(f"{what}: {refused}") from None
        except (OSError, TimeoutError, UnicodeError):
            return


def address_of(host: str) -> IPv4Address | IPv6Address | None:
    """Return the address that `host` is, None for a name. An IPv4 address in IPv6's clothes is shown bare."""
    try:
        address = ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address


def is_loopback(host: str) -> bool:
    """Say whether a server that listens on `host` is reached from its own machine only."""
    address = address_of(host)
    return host == "localhost" if address is None else address.is_loopback
