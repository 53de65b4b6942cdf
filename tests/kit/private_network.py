"""A network namespace of its own for a test that adds and removes interfaces (Linux, root).

In the common one, the browsers of tests that run at the same time would see the network change and abort what
they load (`ERR_NETWORK_CHANGED`).
"""

import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from ctypes import CDLL, get_errno
from pathlib import Path
from typing import Final

import pytest

from tests.kit.waiting import scaled

CENTRE, REMOTE = "10.231.8.1", "10.231.8.2"
"""The addresses of a test and of its other machine."""
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


class Namespace:
    """A network namespace that a veth pair connects with the one of the test."""

    def __init__(self) -> None:
        mark = f"{os.getpid() % 100_000}"
        self.name, self._here, self._there = f"he{mark}", f"ve{mark}", f"vf{mark}"

    def make(self) -> None:
        """Create it; skip the test if this user may not."""
        try:
            ip("netns", "add", self.name)
            pair = ("link", "add", self._here, "type", "veth", "peer", self._there, "netns", self.name)
            ip(*pair)
        except subprocess.CalledProcessError as error:
            self.remove()
            pytest.skip(f"this user may make no network namespaces (root may): {error.stderr.strip()}")
        ip("addr", "add", f"{CENTRE}/24", "dev", self._here)
        ip("-n", self.name, "addr", "add", f"{REMOTE}/24", "dev", self._there)
        ip("-n", self.name, "link", "set", self._there, "up")
        ip("-n", self.name, "link", "set", "lo", "up")
        self.join()

    def remove(self) -> None:
        """Delete it, with the pair."""
        with suppress(subprocess.CalledProcessError):
            ip("netns", "del", self.name)

    def join(self) -> None:
        """Connect the networks."""
        ip("link", "set", self._here, "up")

    def part(self) -> None:
        """Let every packet between the networks be lost, without a word to either side."""
        ip("link", "set", self._here, "down")

    def within(self, *command: str) -> list[str]:
        """Return the command that runs `command` in the namespace."""
        return [shutil.which("ip", path=PATH) or "ip", "netns", "exec", self.name, *command]

    def connect(self, port: int) -> socket.socket:
        """Return a connection to a port of the loopback interface of the namespace."""
        made: list[socket.socket] = []
        failed: list[OSError] = []

        def connect() -> None:  # a thread has a network of its own after setns
            try:
                with Path(f"/run/netns/{self.name}").open() as namespace:
                    enter(namespace.fileno())
                made.append(socket.create_connection(("127.0.0.1", port), timeout=scaled(30)))
            except OSError as error:
                failed.append(error)

        thread = threading.Thread(target=connect)
        thread.start()
        thread.join()
        if failed:
            raise failed[0]
        return made[0]


@contextmanager
def other_machine() -> Iterator[Namespace]:
    """Give this thread a private network, with the address `CENTRE`, and connect it with another, `REMOTE`.

    Skips the test if this user may not.
    """
    require_ip()
    made = Namespace()
    with ExitStack() as stack:
        try:
            stack.enter_context(private_network())
        except OSError as error:
            pytest.skip(f"this user may make no network namespaces (root may): {error}")
        made.make()
        stack.callback(made.remove)
        yield made
