"""A network namespace of its own for a test that adds and removes interfaces (Linux, root).

In the common one, the browsers of tests that run at the same time would see the network change and abort what
they load (`ERR_NETWORK_CHANGED`).
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CDLL, get_errno
from pathlib import Path
from typing import Final

import pytest

CLONE_NEWNET: Final = 0x40000000
OURS: Final = Path("/proc/thread-self/ns/net")
PATH: Final = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
"""Where `ip` is, also for users whose search path is without the folders of the system."""


def ip(*words: str) -> None:
    """Run `ip`. Raises `subprocess.CalledProcessError`."""
    environment = {**os.environ, "PATH": PATH}
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, env=environment)


def require_ip() -> None:
    """Skip the test where `ip` is not installed."""
    if shutil.which("ip", path=PATH) is None:
        pytest.skip("network namespaces need `ip` (apt install iproute2)")


def enter(namespace: int) -> None:
    """Move this thread to the namespace of a file descriptor. Raises `OSError`."""
    if CDLL(None, use_errno=True).setns(namespace, CLONE_NEWNET) != 0:
        raise OSError(get_errno(), "setns")


@contextmanager
def private_network() -> Iterator[None]:
    """Give this thread, and the processes that it starts meanwhile, a network with a loopback interface only.

    Raises `OSError` or `subprocess.CalledProcessError` if this user may not.
    """
    common = os.open(OURS, os.O_RDONLY)
    try:
        if CDLL(None, use_errno=True).unshare(CLONE_NEWNET) != 0:
            raise OSError(get_errno(), "unshare")
        try:
            ip("link", "set", "lo", "up")
            yield
        finally:
            enter(common)
    finally:
        os.close(common)


def is_private() -> bool:
    """Return whether this thread is in a private network."""
    return OURS.stat().st_ino != _COMMON


_COMMON: Final = OURS.stat().st_ino if OURS.exists() else 0
