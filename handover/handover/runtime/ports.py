"""Ports: checks before the start whether a server can listen on its port.

Our ports are in the range of outgoing connections of Linux (32768 to 60999), so an outgoing connection of
this machine may occupy one: while it is open and for a minute afterwards. A server waits for it and logs
that; it does not wait for another program that listens. Reserved ports are not used for connections:
`unreserved` lists the others, and `handover doctor` explains how to reserve them.
"""

import asyncio
import errno
import ipaddress
import os
import socket
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from handover.errors import UsageError
from handover.runtime.retry import Backoff

UNSEEN_TIMEOUT_S = 75.0
"""Waiting time if the system does not show the connection (TIME_WAIT: 60 s on Linux)."""
INITIAL_DELAY_S, MAX_DELAY_S = 0.25, 2.0
SAY_AGAIN_S = 60.0

_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_LISTENS = "0A"
_SYSCTL = Path("/proc/sys/net/ipv4")

Say = Callable[[str], None]


class PortLeaving(UsageError):
    """A connection occupies the port, but no program listens; `peer` is its other end, if known."""

    def __init__(self, words: str, peer: str | None) -> None:
        super().__init__(words)
        self.peer = peer


@dataclass(frozen=True, slots=True)
class _Socket:
    """A TCP socket of this machine: its address, or the other end of its connection."""

    address: str
    peer: str | None


def hold(host: str, port: int, setting: str) -> socket.socket:
    """Reserve `port` against outgoing connections until the returned socket is closed.

    A server that reuses addresses (all of ours do) can listen there meanwhile. The error names `setting`.
    Raises `UsageError` in one line: `PortLeaving` if waiting helps.
    """
    probe = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":  # elsewhere the option would let a second server take the port unnoticed
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if probe.family == socket.AF_INET6:  # as our servers do: `::` leaves IPv4 to others
        probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
    try:
        probe.bind((host, port))
    except OSError as error:
        probe.close()
        where = f"port {port} on {host}"
        way_out = f"set {setting} to another port"
        if error.errno != errno.EADDRINUSE:
            raise UsageError(f"{where} cannot be used ({error.strerror}); {way_out}") from None
        holders = _holders(host, port)
        listens = any(holder.peer is None for holder in holders) if holders else _has_listener(host, port)
        if listens:
            raise UsageError(f"{where} is taken by another program; stop that program or {way_out}") from None
        peer = holders[0].peer if holders else None
        to = f" to {peer}" if peer else ""
        raise PortLeaving(
            f"{where} is held by a connection of another program{to}; {way_out}", peer
        ) from None
    if os.name != "posix":  # a socket that is only bound would block the server
        probe.close()
    return probe


def hold_when_free(host: str, port: int, setting: str, *, say: Say) -> socket.socket:
    """Reserve the port as `hold` does, after waiting for a connection to end; `say` gets progress lines.

    Raises `UsageError` in one line if waiting does not help.
    """
    for attempt in _attempts(host, port, setting, say):
        if isinstance(attempt, socket.socket):
            return attempt
        time.sleep(attempt)
    raise AssertionError  # the attempts end with a socket or an error


def require_free(host: str, port: int, setting: str, *, say: Say) -> None:
    """Wait until `port` is free, as `hold_when_free` does, without reserving it."""
    hold_when_free(host, port, setting, say=say).close()


async def held(host: str, port: int, setting: str, *, say: Say) -> socket.socket:
    """Reserve the port as `hold_when_free` does, asynchronously."""
    for attempt in _attempts(host, port, setting, say):
        if isinstance(attempt, socket.socket):
            return attempt
        await asyncio.sleep(attempt)
    raise AssertionError  # the attempts end with a socket or an error


def unreserved(ports: Iterable[int]) -> list[int]:
    """Return those of `ports` that Linux may use for outgoing connections; none on other systems."""
    try:
        first, last = map(int, (_SYSCTL / "ip_local_port_range").read_text().split())
        reserved = reserved_ports()
    except (OSError, ValueError):
        return []
    return sorted({port for port in ports if first <= port <= last and port not in reserved})


def reserved_ports() -> set[int]:
    """Return the ports that Linux never uses for outgoing connections. Raises `OSError` on other systems."""
    inodes: set[int] = set()
    for part in (_SYSCTL / "ip_local_reserved_ports").read_text().strip().split(","):
        first, _, last = part.partition("-")
        if first:
            inodes.update(range(int(first), int(last or first) + 1))
    return inodes


def _attempts(host: str, port: int, setting: str, say: Say) -> Iterator[socket.socket | float]:
    """Try to reserve the port: yield the delay before each further attempt, finally the socket."""
    began_s = say_at_s = time.monotonic()
    backoff = Backoff(INITIAL_DELAY_S, MAX_DELAY_S, jitter=0.0)
    while True:
        try:
            yield hold(host, port, setting)
        except PortLeaving as leaving:
            now_s = time.monotonic()
            if leaving.peer is None and now_s > began_s + UNSEEN_TIMEOUT_S:
                raise
            if now_s >= say_at_s:
                by = f"a connection to {leaving.peer}" if leaving.peer else "a connection that has just ended"
                say(
                    f"port {port} is held by {by}; waiting until it is free. `handover doctor` says how to "
                    f"reserve it; {setting} sets another"
                )
                say_at_s = now_s + SAY_AGAIN_S
            yield backoff.next_delay_s()
        else:
            return


def _holders(host: str, port: int) -> list[_Socket]:
    """Return the sockets on `port` that block a server on `host`, as far as the system shows them."""
    ours = _addresses(host)
    sockets = [entry for table in _TABLES for entry in _sockets(table, port)]
    anywhere = {"0.0.0.0", "::"}  # noqa: S104 - compared, not bound
    return [entry for entry in sockets if entry.address in ours | anywhere or ours & anywhere]


def _sockets(table: Path, port: int) -> Iterator[_Socket]:
    """Yield the sockets on `port` in a table of Linux: address, peer and state are its columns 2 to 4."""
    try:
        lines = table.read_text().splitlines()[1:]
    except OSError:
        return
    for line in lines:
        _, local, remote, state, *_ = line.split()
        address, _, number = local.partition(":")
        if int(number, 16) == port:
            peer, _, peer_port = remote.partition(":")
            end = None if state == _LISTENS else f"{_readable(peer)}:{int(peer_port, 16)}"
            yield _Socket(_readable(address), end)


def _readable(address: str) -> str:
    """Return an address in its usual notation; Linux uses 32-bit words in the machine's byte order."""
    words = struct.pack(
        f"={len(address) // 8}I", *(int(address[i : i + 8], 16) for i in range(0, len(address), 8))
    )
    read = ipaddress.ip_address(words)
    mapped = read.ipv4_mapped if isinstance(read, ipaddress.IPv6Address) else None
    return str(mapped or read)


def _addresses(host: str) -> set[str]:
    try:
        return {
            str(address_info[4][0])
            for address_info in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
        }
    except OSError:
        return {host}


def _has_listener(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=1.0) as met:
            return bool(met.getsockname() != met.getpeername())  # on loopback a socket can connect to itself
    except TimeoutError:
        return True
    except OSError:
        return False
