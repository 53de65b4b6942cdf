"""The outbound policy: the addresses that a service connects to when a client names them.

Clients name addresses in subscriptions, registrations, snapshots, @contexts and process definitions, and
could make a service reach what they cannot reach themselves. Each address has an `AddressKind`. A service
that listens on loopback refuses a few kinds, and with accounts also this machine; one that listens beyond
loopback refuses all that are not public. The endpoints of our own services are always allowed, and so are
hosts, endpoints (`host:port`) and networks in HANDOVER_OUTBOUND_ALLOW.

Names are checked by the addresses they resolve to, and the connection is made to a checked address, never to
the name. A name that resolves to another address a moment later has no effect.
"""

import asyncio
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network
from pathlib import Path
from typing import Final, Self

_ENDPOINT: Final = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\[\]/\s]+):(\d{1,5})")
SETTING: Final = "HANDOVER_OUTBOUND_ALLOW"
Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network


class AddressRefused(Exception):
    """The destination is refused; the text names the rule and the setting."""


class AddressKind(Enum):
    """The kind of an address, as in error texts."""

    LOOPBACK = "an address of this machine"
    LINK_LOCAL = "a link-local address"
    METADATA = "an address of a cloud's metadata service"
    PRIVATE = "an address of a private network"
    MULTICAST = "a multicast address"
    RESERVED = "a reserved address"
    TRANSLATED = "an IPv6 address that stands for an IPv4 address"


_KINDS: Final[tuple[tuple[AddressKind, tuple[str, ...]], ...]] = (
    (AddressKind.LOOPBACK, ("127.0.0.0/8", "0.0.0.0/8", "::1/128", "::/128")),
    (
        AddressKind.METADATA,
        ("100.100.100.200/32", "168.63.129.16/32", "169.254.169.254/32", "192.0.0.192/32",
         "fd00:ec2::254/128", "fd20:ce::254/128"),
    ),
    (AddressKind.LINK_LOCAL, ("169.254.0.0/16", "fe80::/10")),
    (
        AddressKind.PRIVATE,
        ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "100.64.0.0/10", "198.18.0.0/15", "192.0.0.0/24",
         "fc00::/7", "fec0::/10"),
    ),
    (AddressKind.MULTICAST, ("224.0.0.0/4", "ff00::/8")),
    (
        AddressKind.TRANSLATED,
        ("64:ff9b::/96", "64:ff9b:1::/48", "2002::/16", "2001::/32", "::/96", "::ffff:0:0:0/96"),
    ),
    (
        AddressKind.RESERVED,
        ("240.0.0.0/4", "192.0.2.0/24", "198.51.100.0/24", "203.0.113.0/24", "192.88.99.0/24",
         "2001::/23", "2001:db8::/32", "3fff::/20"),
    ),
)  # fmt: skip
"""The first kind that lists an address is its kind (IANA's special-purpose address registries)."""
_NETWORKS: Final = tuple((kind, ip_network(network)) for kind, listed in _KINDS for network in listed)
_PUBLIC_IPV6: Final = ip_network("2000::/3")
_ALWAYS_REFUSED: Final = frozenset({AddressKind.LINK_LOCAL, AddressKind.METADATA, AddressKind.MULTICAST})
"""Kinds that a service refuses even if it listens on loopback only."""


@dataclass(frozen=True, slots=True)
class OutboundPolicy:
    """The allowed addresses. `listens_beyond_loopback`: clients on other machines can choose them, too.

    `hosts` (names, in lower case) and `networks` are allowed whatever their kind is.
    """

    listens_beyond_loopback: bool = False
    hosts: frozenset[str] = frozenset()
    networks: tuple[Network, ...] = ()
    endpoints: frozenset[tuple[str, int]] = frozenset()
    """Hosts (names or addresses, in lower case) with a port that are allowed."""
    accounts_file: Path | None = None
    """The file that exists as soon as there are accounts; then clients are no longer this machine's user."""
    components_file: Path | None = None
    """A file with the endpoints of registered components, one a line; it may change at any time."""

    @classmethod
    def of(
        cls,
        host: str,
        allowed: str,
        *,
        endpoints: Iterable[tuple[str, int]] = (),
        accounts_file: Path | None = None,
        components_file: Path | None = None,
    ) -> Self:
        """Return the policy of a server that listens on `host`, with the setting's text `allowed`.

        Raises `ValueError` that names an entry which is neither a host nor a network.
        """
        hosts, networks, named = set[str](), list[Network](), set(endpoints)
        for entry in filter(None, (part.strip() for part in allowed.split(","))):
            endpoint = _ENDPOINT.fullmatch(entry)
            if endpoint is not None:
                named.add((_plain(endpoint[1].strip("[]")), int(endpoint[2])))
                continue
            try:
                networks.append(ip_network(entry.strip("[]")))
            except ValueError as error:
                if not _is_name(entry):
                    raise ValueError(
                        f"{entry!r} is neither a host name nor an address or network ({error})"
                    ) from None
                hosts.add(_plain(entry))
        return cls(
            not is_loopback(host),
            frozenset(hosts),
            tuple(networks),
            frozenset(named),
            accounts_file,
            components_file,
        )

    def _is_listed(self, host: str, port: int) -> bool:
        """Return whether an endpoint is one of the setting, of our services or of a registered component."""
        endpoint = _plain(host), port
        return endpoint in self.endpoints or endpoint in _endpoints_in(self.components_file)

    def fault_of(self, host: str, port: int = 0) -> str | None:
        """Return why the address `host` is refused; None if it is allowed, or a name to resolve."""
        if self._is_listed(host, port):
            return None
        address = address_of(host)
        kind = None if address is None else kind_of(address)
        if address is None or kind is None or any(address in network for network in self.networks):
            return None
        if self.listens_beyond_loopback:
            why = "a service that listens beyond loopback"
        elif kind in _ALWAYS_REFUSED or (kind is AddressKind.TRANSLATED and self._is_refused_within(address)):
            why = "this service"
        elif (
            self.accounts_file is not None and self._is_this_machine(address) and self.accounts_file.exists()
        ):
            why = "a service with accounts, for others than our own services,"
        else:
            return None
        return (
            f"{host} is {kind.value}, to which {why} does not connect; choose another one, or list the host "
            f"or its network in {SETTING}"
        )

    @staticmethod
    def _is_refused_within(address: Address) -> bool:
        return any(kind_of(embedded) in _ALWAYS_REFUSED for embedded in embedded_in(address))

    def _has_accounts(self) -> bool:
        return self.accounts_file is not None and self.accounts_file.exists()

    @staticmethod
    def _is_this_machine(address: Address) -> bool:
        return any(kind_of(embedded) is AddressKind.LOOPBACK for embedded in (address, *embedded_in(address)))

    async def resolved(self, host: str, port: int) -> list[str]:
        """Return the allowed addresses of `host`, in the order to try them.

        Raises `AddressRefused` when all are refused, `OSError` when the name cannot be resolved.
        """
        if address_of(host) is not None:
            addresses = [host]
        else:
            answers = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
            addresses = list(dict.fromkeys(str(address_info[4][0]) for address_info in answers))
            if _plain(host) in self.hosts or self._is_listed(host, port):
                return addresses
        faults = {address: self.fault_of(address, port) for address in addresses}
        allowed = [address for address, fault in faults.items() if fault is None]
        if not allowed:
            why = next((fault for fault in faults.values() if fault), f"{host} has no address")
            raise AddressRefused(why if host in faults else f"{host} resolves to a refused address: {why}")
        return allowed


def _endpoints_in(file: Path | None) -> frozenset[tuple[str, int]]:
    if file is None:
        return frozenset()
    try:
        state = file.stat()
    except OSError:
        return frozenset()
    return _read_endpoints(file, state.st_mtime_ns, state.st_ino)


@lru_cache(maxsize=8)
def _read_endpoints(file: Path, mtime_ns: int, inode: int) -> frozenset[tuple[str, int]]:  # noqa: ARG001
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return frozenset()
    matches = (_ENDPOINT.fullmatch(line.partition(" ")[0]) for line in lines)
    return frozenset((_plain(match[1].strip("[]")), int(match[2])) for match in matches if match is not None)


def address_of(host: str) -> Address | None:
    """Return the address in `host`, None for a name; an IPv4-mapped IPv6 address as the IPv4 address."""
    try:
        address = ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address


@lru_cache(maxsize=4096)
def kind_of(address: Address) -> AddressKind | None:
    """Return the kind of an address, None for a public one."""
    for kind, network in _NETWORKS:
        if address in network:
            return kind
    if isinstance(address, IPv6Address) and address not in _PUBLIC_IPV6:
        return AddressKind.RESERVED
    return None


def embedded_in(address: Address) -> list[IPv4Address]:
    """Return the IPv4 addresses embedded in an IPv6 address (NAT64, 6to4, Teredo, IPv4-compatible)."""
    if not isinstance(address, IPv6Address):
        return []
    last = IPv4Address(int(address) & 0xFFFF_FFFF)
    if address.sixtofour is not None:
        return [address.sixtofour]
    return list(address.teredo) if address.teredo is not None else [last]


@lru_cache(maxsize=1024)
def is_loopback(host: str) -> bool:
    """Return whether `host` is this machine only: a loopback address (IPv4-mapped and scoped ones too), or
    the name `localhost`.

    It answers for the address on which a server listens as for the address of a peer.
    """
    address = address_of(host.partition("%")[0])
    return host == "localhost" if address is None else address.is_loopback


def _plain(host: str) -> str:
    return host.rstrip(".").lower()


def _is_name(text: str) -> bool:
    labels = _plain(text).split(".")
    named = all(label and label.replace("-", "").replace("_", "").isalnum() for label in labels)
    return named and not labels[-1].isdecimal()
