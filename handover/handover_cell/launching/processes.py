"""Processes of the launcher: forked from a fork server where possible, otherwise started as programs."""

import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Protocol

from handover.runtime.python_processes import module_command
from handover.telemetry import get_logger

if sys.platform == "linux":
    from handover_cell.launching import fork_server

log = get_logger(__name__)

_MODULE_COMMAND = module_command("")[:-1]


class Process(Protocol):
    """A running process: of asyncio, or of the fork server."""

    @property
    def pid(self) -> int:
        """The process id."""
        ...

    @property
    def returncode(self) -> int | None:
        """The exit status as `subprocess.Popen` has it; None while the process runs."""
        ...

    async def wait(self) -> int:
        """Return the exit status when the process has ended."""
        ...

    def terminate(self) -> None:
        """Ask the process to end; raise `ProcessLookupError` if it has ended."""
        ...

    def kill(self) -> None:
        """End the process; raise `ProcessLookupError` if it has ended."""
        ...


class ForkedProcess:
    """A process of the fork server, which reports its exit status; signals go by a descriptor, not a number.

    If the server is killed, nobody can read the exit status any more: the process is then ended, and counts
    as ended by SIGTERM. Its number may belong to another program by then, its descriptor may not.
    """

    def __init__(self, pid: int, reports: asyncio.StreamReader, close: Callable[[], None]) -> None:
        self.pid = pid
        self._close = close
        self._handle: int | None = None
        with contextlib.suppress(ProcessLookupError):  # it has ended, and the server has read its status
            self._handle = os.pidfd_open(pid)
        self._end = asyncio.create_task(self._status(reports))

    @property
    def returncode(self) -> int | None:
        """The exit status; None while the process runs."""
        return self._end.result() if self._end.done() else None

    async def wait(self) -> int:
        """Return the exit status when the process has ended."""
        return await asyncio.shield(self._end)

    def terminate(self) -> None:
        """Ask the process to end; raise `ProcessLookupError` if it has ended."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End the process; raise `ProcessLookupError` if it has ended."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self._handle is None:
            raise ProcessLookupError
        signal.pidfd_send_signal(self._handle, number)

    async def _status(self, reports: asyncio.StreamReader) -> int:
        try:
            line = await _line(reports)
            if line:
                return int(line)
            await self._end_without_server()
            return -signal.SIGTERM
        finally:
            if self._handle is not None:
                os.close(self._handle)
                self._handle = None
            self._close()

    async def _end_without_server(self) -> None:
        """End the process, and wait for its end."""
        if self._handle is None:
            return
        with contextlib.suppress(ProcessLookupError):
            self.terminate()
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self._handle, ended.set)
        try:
            await ended.wait()
        finally:
            loop.remove_reader(self._handle)


class ProcessStarter:
    """Starts processes in sessions of their own, whose standard input is closed when this process ends.

    On Linux modules of this Python are forked from a fork server, in a fraction of the time. Without one
    (other systems; a library that starts threads; a server that was killed) they are started as programs.
    """

    def __init__(self) -> None:
        self._requests: socket.socket | None = None
        self._server: subprocess.Popen[bytes] | None = None
        self._lock = asyncio.Lock()

    def open(self) -> None:
        """Start the fork server, where there can be one."""
        if sys.platform != "linux":
            return
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._server = subprocess.Popen(  # noqa: S603 - our own module
                module_command(fork_server.__name__, str(theirs.fileno())),
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )

    async def close(self) -> None:
        """End the fork server; processes that still run are not ended."""
        if self._requests is not None:
            self._requests.close()
            self._requests = None
        if self._server is not None:
            await asyncio.to_thread(self._server.wait)
            self._server = None

    async def start(
        self, command: Sequence[str], environment: Mapping[str, str], output: IO[bytes]
    ) -> Process:
        """Start `command`; its output and errors go to `output`."""
        if self._requests is not None and list(command[: len(_MODULE_COMMAND)]) == _MODULE_COMMAND:
            with contextlib.suppress(OSError):
                return await self._fork(self._requests, command[len(_MODULE_COMMAND) :], environment, output)
            self._requests.close()
            self._requests = None
            log.warning("the fork server has ended; services start as programs, with more memory")
        return await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=output,
            stderr=output,
            env=environment,
            start_new_session=True,
        )

    async def _fork(
        self, requests: socket.socket, words: Sequence[str], environment: Mapping[str, str], output: IO[bytes]
    ) -> ForkedProcess:
        """Raise `OSError` if the server does not start a process."""
        assert sys.platform == "linux"  # noqa: S101 - there is a server
        request = fork_server.request(words[0], words[1:], environment, Path.cwd(), session=True)
        connection, reported = socket.socketpair()
        standard_input, lifeline = os.pipe()
        reports, writer = await asyncio.open_connection(sock=connection)

        def close() -> None:
            writer.close()
            os.close(lifeline)

        try:
            socket.send_fds(
                requests,
                [request],
                [standard_input, output.fileno(), reported.fileno()],
            )
        except OSError:
            close()
            raise
        finally:
            reported.close()
            os.close(standard_input)
        line = await _line(reports)
        if not line:
            close()
            raise ConnectionResetError
        return ForkedProcess(int(line), reports, close)


async def _line(reports: asyncio.StreamReader) -> bytes:
    """Return the next line of the fork server; empty if it has ended."""
    with contextlib.suppress(ConnectionError):
        return await reports.readline()
    return b""
