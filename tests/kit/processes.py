"""Services as real processes: started, waited for, killed, stopped."""

import atexit
import functools
import os
import select
import signal
import socket
import ssl
import subprocess
import sys
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import httpx

from handover.runtime.python_processes import module_command
from handover_cell.launching import fork_server
from tests.kit import lifeline
from tests.kit.private_network import is_private
from tests.kit.waiting import scaled, wait_for

MAX_LOG_EXCERPT = 3000


class Process(Protocol):
    """A running process: a `subprocess.Popen`, or one of the fork server."""

    @property
    def pid(self) -> int: ...

    def poll(self) -> int | None:
        """Return the exit status as `subprocess.Popen` does, None while the process runs."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; raise `subprocess.TimeoutExpired` after `timeout` seconds."""
        ...

    def send_signal(self, sig: int) -> None: ...

    def terminate(self) -> None: ...

    def kill(self) -> None: ...


class ForkedProcess:
    """A process of the fork server, read from its status pipe."""

    def __init__(self, module: str, status: int) -> None:
        self._module = module
        self._status = os.fdopen(status, "rb", buffering=0)
        weakref.finalize(self, self._status.close)
        self.pid = int(self._status.readline())
        self.returncode: int | None = None

    def poll(self) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            if not select.select([self._status], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self._module, timeout or 0)
            self.returncode = int(self._status.readline())
            self._status.close()
        return self.returncode

    def send_signal(self, sig: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, sig)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


@functools.cache
def _fork_server() -> socket.socket:
    """Return the connection to the fork server of this run; the server ends with it."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        server = subprocess.Popen(
            [*module_command(fork_server.__name__), str(theirs.fileno())],
            env=clean_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
        )
    atexit.register(_stop_fork_server, server, ours)
    return ours


def _stop_fork_server(server: subprocess.Popen[bytes], connection: socket.socket) -> None:
    connection.close()
    server.wait()


def clean_environment() -> dict[str, str]:
    """Return the environment without settings of Handover, which a developer's shell may contain."""
    return {name: value for name, value in os.environ.items() if not name.startswith("HANDOVER_")}


def spawn(
    command: Sequence[str], environment: Mapping[str, str], log: Path, folder: Path
) -> subprocess.Popen[bytes]:
    """Start a process in `folder` that ends with the test run; its output is appended to `log`."""
    with log.open("ab") as output:
        return subprocess.Popen(
            list(command),
            env={**environment, **lifeline.ENVIRONMENT},
            cwd=folder,
            stdin=lifeline.STDIN,
            stdout=output,
            stderr=output,
        )


def spawn_module(module: str, environment: Mapping[str, str], log: Path, folder: Path) -> Process:
    """Run a module as `spawn` does, in less time: forked from a process that has imported the libraries.

    That process is in the common network.
    """
    if sys.platform != "linux" or is_private():
        return spawn(module_command(module), environment, log, folder)
    variables = {**environment, **lifeline.ENVIRONMENT}
    request = fork_server.request(module, [], variables, folder, session=False)
    reader, writer = os.pipe()
    try:
        with log.open("ab") as output:
            socket.send_fds(_fork_server(), [request], [lifeline.STDIN, output.fileno(), writer])
    finally:
        os.close(writer)
    return ForkedProcess(module, reader)


@functools.cache
def _ssl_context() -> ssl.SSLContext:
    """Return one context for all: to load the certificate authorities takes 15 ms."""
    return httpx.create_ssl_context()


def answer(process: Process | None, url: str, log: Callable[[], str]) -> httpx.Response | None:
    """Return the answer of `url`, None while nothing listens; fail if the process has ended."""
    assert process is None or process.poll() is None, f"the process has ended: {log()[-MAX_LOG_EXCERPT:]}"
    try:
        return httpx.get(url, trust_env=False, timeout=scaled(5), verify=_ssl_context())
    except httpx.TransportError:
        return None


def is_up(answered: httpx.Response) -> bool:
    """Return whether a service is ready, or a broker answers a query, if only that the tenant is new."""
    return answered.status_code < 500


def wait_ready(process: Process | None, url: str, log: Callable[[], str], within_s: float = 30.0) -> None:
    """Wait until `url` answers as a service that is ready does."""

    def is_ready() -> bool:
        answered = answer(process, url, log)
        return answered is not None and is_up(answered)

    wait_for(is_ready, within_s, lambda: f"{url} is not ready: {log()[-MAX_LOG_EXCERPT:]}")


def kill(process: Process) -> None:
    """End a process as a power cut would."""
    process.send_signal(signal.SIGKILL)
    process.wait()


def stop(process: Process, within_s: float = 10.0) -> None:
    """End a process in good order; kill it and raise TimeoutExpired if it does not end in time."""
    process.terminate()
    try:
        process.wait(scaled(within_s))
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise
