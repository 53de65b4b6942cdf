"""Free ports for test processes."""

import itertools
import os
import re
import socket

_worker = int(re.sub(r"\D", "", os.environ.get("PYTEST_XDIST_WORKER", "")) or 0)
_candidates = itertools.count(15_000 + 2_000 * (_worker % 8) + os.getpid() * 37 % 1_200)


def next_free_port() -> int:
    """Return a port on which nobody listens, below the ephemeral range; each call gives another."""
    for port in _candidates:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("no free port")
