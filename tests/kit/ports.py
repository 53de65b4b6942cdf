"""Free ports for test processes, which no other process of tests on this machine gets.

A port is used some time after it was chosen, or never, as that of a service that a test does not start. So
it is reserved: by a lock on one byte of a file that all processes of tests share, until the process ends.
A process keeps its latest `MAX_RESERVED` ports, those of more cells than it has at a time.
"""

import fcntl
import itertools
import os
import re
import socket
import tempfile
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Final

PORTS: Final = range(15_000, 32_768)
"""Below the ephemeral ports, from which the kernel chooses those of clients."""
MAX_RESERVED: Final = 1_500

_worker = int(re.sub(r"\D", "", os.environ.get("PYTEST_XDIST_WORKER", "")) or 0)
_first = 2_000 * (_worker % 8) + os.getpid() * 37 % 1_200
_order: Iterator[int] = itertools.cycle((*PORTS[_first:], *PORTS[:_first]))
_reserved: deque[int] = deque()
_locks = os.open(
    Path(tempfile.gettempdir()) / f"handover-test-ports-{os.getuid()}",
    os.O_RDWR | os.O_CREAT | os.O_CLOEXEC,
    0o600,
)
"""Never closed: closing any descriptor of the file would end all locks of this process."""


def next_free_port() -> int:
    """Reserve a port on which nobody listens, below the ephemeral range; each call gives another."""
    for port in itertools.islice(_order, len(PORTS)):
        if port in _reserved or not reserve(port):
            continue
        if not _is_free(port):
            release(port)
            continue
        _reserved.append(port)
        if len(_reserved) > MAX_RESERVED:
            release(_reserved.popleft())
        return port
    raise AssertionError("no free port")


def reserve(number: int) -> bool:
    """Reserve a number until this process ends; return whether no other process of tests has it."""
    try:
        fcntl.lockf(_locks, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, number)
    except OSError:
        return False
    return True


def release(number: int) -> None:
    """Leave a reserved number to other processes."""
    fcntl.lockf(_locks, fcntl.LOCK_UN, 1, number)


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
