"""The sockets on which processes receive what anybody sends."""

import socket
from collections.abc import Iterable
from contextlib import suppress
from typing import NamedTuple

import psutil


class Listening(NamedTuple):
    """A socket that accepts connections, or datagrams of anybody."""

    protocol: str
    address: str
    port: int
    process: str


def listening_sockets(pids: Iterable[int]) -> set[Listening]:
    """Return the sockets of these processes and all of their children."""
    found = set()
    for pid in pids:
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):  # a child that has ended meanwhile
                found |= _sockets_of(one)
    return found


def _sockets_of(process: psutil.Process) -> set[Listening]:
    command = " ".join(process.cmdline())
    return {
        Listening("udp" if one.type == socket.SOCK_DGRAM else "tcp", one.laddr.ip, one.laddr.port, command)
        for one in process.net_connections("inet")
        if one.laddr and not one.raddr and one.status in {psutil.CONN_LISTEN, psutil.CONN_NONE}
    }
