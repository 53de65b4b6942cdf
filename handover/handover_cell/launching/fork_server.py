"""Runs modules as processes that are forked from a process with the libraries already imported (Linux).

A service spends most of its start on imports, and a cell has a dozen services. The server imports the common
libraries once and starts no thread; each process imports its own module and runs it as `python -P -m` does,
with its own environment, folder and standard streams, in a session of its own.

Protocol (SOCK_SEQPACKET): a request is a JSON object with three file descriptors: standard input, output (for
errors too) and the status pipe. To the pipe the server writes the process id and, at the end of the process,
its exit status, both as lines. The server ends when the other end of the socket is closed.

Only for modules that are in this environment: what a process may do is decided by who holds the socket.
"""

import gc
import importlib
import json
import os
import resource
import runpy
import selectors
import signal
import socket
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from handover.runtime.python_processes import module_command

PRELOADED: Final = (
    "croniter",
    "cryptography.hazmat.primitives.asymmetric.ed25519",
    "cryptography.x509",
    "fastapi",
    "httpx",
    "jsonschema",
    "jwt",
    "lxml.etree",
    "orjson",
    "prometheus_client",
    "pydantic_settings",
    "sqlalchemy.dialects.sqlite",
    "structlog",
    "uvicorn.lifespan.on",
    "uvicorn.loops.uvloop",
    "uvicorn.protocols.http.httptools_impl",
    "uvicorn.protocols.websockets.auto",
    "websockets.asyncio.client",
    "yaml",
    "handover_datamodels.entities",
    "handover.broker",
    "handover.performer",
    "handover.serving.server",
    "handover.serving.storage",
)
"""None of them may start a thread: a forked process would lack it (NumPy's linear algebra does)."""
LIMITS: Final = (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE)
"""The resource limits of a process: those of the client at the time of the request."""
MAX_REQUEST_BYTES: Final = 1 << 20
MAX_DESCRIPTORS: Final = 1024
THREADED = 3
"""The exit code when a library has started a thread."""


def request(
    module: str, arguments: Sequence[str], environment: Mapping[str, str], folder: Path, *, session: bool
) -> bytes:
    """Return a request to run a module with the resource limits of this process."""
    return json.dumps(
        {
            "module": module,
            "arguments": list(arguments),
            "environment": dict(environment),
            "folder": str(folder.absolute()),
            "session": session,
            "limits": [resource.getrlimit(limit) for limit in LIMITS],
        }
    ).encode()


def serve(requests: socket.socket) -> dict[str, Any] | None:
    """Serve until the other end of `requests` is closed: then return None.

    Returns in each forked process too, with its request.
    """
    statuses: dict[int, int] = {}
    """The status pipes by process id."""
    wake_up, woken = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.set_wakeup_fd(woken)
    signal.signal(signal.SIGCHLD, lambda *_: None)  # wakes up the selector
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal also reaches the processes
    with selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        selector.register(wake_up, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is not requests:
                    os.read(wake_up, MAX_DESCRIPTORS)
                    _report_ended(statuses)
                    continue
                received, descriptors, _, _ = socket.recv_fds(requests, MAX_REQUEST_BYTES, 3)
                if not received:
                    return None
                process = os.fork()
                if process == 0:
                    return _prepare(json.loads(received), *descriptors)
                *streams, statuses[process] = descriptors
                for stream in streams:
                    os.close(stream)
                with suppress(BrokenPipeError):  # the client has ended; so will the process
                    os.write(statuses[process], f"{process}\n".encode())


def _report_ended(statuses: dict[int, int]) -> None:
    while statuses:
        process, status = os.waitpid(-1, os.WNOHANG)
        if process == 0:
            return
        pipe = statuses.pop(process)
        with suppress(BrokenPipeError):  # nobody asks for it any more
            os.write(pipe, f"{os.waitstatus_to_exitcode(status)}\n".encode())
        os.close(pipe)


def _prepare(accepted: dict[str, Any], standard_input: int, output: int, _status: int) -> dict[str, Any]:
    """Give this process what the request asks for, and nothing of the server."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if accepted["session"]:
        os.setsid()
    for descriptor, source in enumerate((standard_input, output, output)):
        os.dup2(source, descriptor)
    os.closerange(3, MAX_DESCRIPTORS)
    for limit, value in zip(LIMITS, accepted["limits"], strict=True):
        resource.setrlimit(limit, tuple(value))
    os.environ.clear()
    os.environ.update(accepted["environment"])
    os.chdir(accepted["folder"])
    return accepted


def _name(accepted: dict[str, Any]) -> None:
    """Show the module in `ps` and `top` in place of this server."""
    with suppress(ModuleNotFoundError):
        import setproctitle  # noqa: PLC0415 - not on other systems

        setproctitle.setproctitle(" ".join(module_command(accepted["module"], *accepted["arguments"])))
    Path("/proc/self/comm").write_text(accepted["module"].rpartition(".")[2])


def _prepare_names() -> None:
    """Find the place of the name; the library needs the environment for it, which is replaced later."""
    with suppress(ModuleNotFoundError):
        import setproctitle  # noqa: PLC0415 - not on other systems

        setproctitle.getproctitle()


def main() -> None:
    """Import the libraries, serve, and in a forked process run its module."""
    for module in PRELOADED:
        with suppress(ImportError):  # a service that needs it says so itself
            importlib.import_module(module)
    if len(list(Path("/proc/self/task").iterdir())) > 1:
        raise SystemExit(THREADED)
    _prepare_names()
    gc.collect()
    gc.freeze()  # otherwise each process would copy all memory that it shares with the server
    requests = socket.socket(fileno=int(sys.argv[1]))
    accepted = serve(requests)
    if accepted is None:
        return
    requests.detach()  # it is closed already
    _name(accepted)
    added = accepted["environment"].get("PYTHONPATH", "")
    sys.path[:0] = filter(None, added.split(os.pathsep))
    sys.argv = [accepted["module"], *accepted["arguments"]]
    runpy.run_module(accepted["module"], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
