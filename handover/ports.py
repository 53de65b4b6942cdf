"""Ports: whether a server may listen where it is set to, told in one line before anything starts.

Our ports lie where systems also number outgoing connections (Linux: 32768 to 60999), so on a busy machine
one may be held for a minute by a connection that has just ended. That is waited for; another program that
listens is not.
"""

import asyncio
import errno
import os
import socket
import time
from collections.abc import Callable, Iterator

from handover.errors import UsageError

LEAVING_S = 75.0
"""Longer than the systems we run on remember an ended TCP connection (TIME_WAIT: 60 s on Linux)."""
LOOK_EVERY_S = 0.25

Say = Callable[[str], None]


class PortLeaving(UsageError):
    """Nobody listens on the port, but a connection, most likely one that has just ended, still has it."""


def hold(host: str, port: int, setting: str) -> socket.socket:
    """Keep `port` from being given to an outgoing connection until what is returned is closed.

    A server that reuses addresses (all of ours do) can listen there meanwhile. `setting` names the way
    out. Raises `UsageError` in one line: `PortLeaving` where waiting helps.
    """
    probe = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":  # elsewhere the option would let a second server take the port unnoticed
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        probe.bind((host, port))
    except OSError as error:
        probe.close()
        where = f"port {port} on {host}"
        way_out = f"set {setting} to another port"
        if error.errno != errno.EADDRINUSE:
            raise UsageError(f"{where} cannot be used ({error.strerror}); {way_out}") from None
        if _somebody_listens(host, port):
            raise UsageError(f"{where} is taken by another program; stop that program or {way_out}") from None
        raise PortLeaving(f"{where} is held by a connection of another program; {way_out}") from None
    if os.name != "posix":  # a socket that is only bound would keep the server away
        probe.close()
    return probe


def require_free(host: str, port: int, setting: str, *, say: Say) -> None:
    """Return when `port` can be listened on; raise `UsageError` in one line when it cannot.

    A port that only a leaving connection holds is waited for, up to `LEAVING_S`, and `say` gets a line.
    """
    for attempt in _attempts(host, port, setting, say):
        if attempt is not None:
            attempt.close()
            return
        time.sleep(LOOK_EVERY_S)


async def held(host: str, port: int, setting: str, *, say: Say) -> socket.socket:
    """Return the port held, as `hold` does, once no leaving connection has it any more."""
    for attempt in _attempts(host, port, setting, say):
        if attempt is not None:
            return attempt
        await asyncio.sleep(LOOK_EVERY_S)
    raise AssertionError  # the attempts end with a socket or an error


def _attempts(host: str, port: int, setting: str, say: Say) -> Iterator[socket.socket | None]:
    """Try to hold the port again and again: yield None where waiting may help, then the port held."""
    deadline_s = time.monotonic() + LEAVING_S
    told = False
    while True:
        try:
            attempt = hold(host, port, setting)
        except PortLeaving:
            if time.monotonic() > deadline_s:
                raise
        else:
            yield attempt
            return
        if not told:
            say(f"port {port} is held by a connection that has just ended; waiting for it, a minute at most")
            told = True
        yield None


def _somebody_listens(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), timeout=1.0) as met:
            return bool(met.getsockname() != met.getpeername())  # on loopback one can meet oneself
    except TimeoutError:
        return True
    except OSError:
        return False
