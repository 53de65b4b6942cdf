"""The supervisor of one service in a container: starts it, forwards signals, restarts it when it is stuck.

It forks, so that both processes share the memory of what is imported. The service is a child whose standard
input is a pipe of the supervisor: it ends when the supervisor is killed (`LIFELINE`). When the service ends
by itself the supervisor ends with the same status, and the restart policy of the container decides.
"""

import asyncio
import contextlib
import os
import signal
import sys
from collections.abc import Callable

from handover.errors import UsageError
from handover.serving.watchdog import Watchdog
from handover.settings import LIFELINE, RESTARTED, Settings

LOOK_EVERY_S = 0.1
_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def run_watched(name: str, url: str, settings: Settings, say: Callable[[str], None]) -> None:
    """Start the service in a child process, in which this returns; the supervisor itself exits.

    Raises `UsageError` on other systems than Linux.
    """
    if sys.platform != "linux":
        raise UsageError("--watch needs Linux; run the service without it")
    watchdog = Watchdog(name, url, settings, say)
    was_stuck = False
    while True:
        reading, writing = os.pipe()
        service = os.fork()
        if service == 0:
            os.close(writing)
            os.dup2(reading, 0)
            os.close(reading)
            os.environ[LIFELINE] = "1"
            if was_stuck:
                os.environ[RESTARTED] = "1"
            return
        os.close(reading)
        was_stuck, status = asyncio.run(_supervise(service, watchdog))
        os.close(writing)
        if not was_stuck:
            raise SystemExit(128 - status if status < 0 else status)
        say(f"{name} was ended by the watchdog; starting it again")


async def _supervise(service: int, watchdog: Watchdog) -> tuple[bool, int]:
    """Wait for the end of the process; return whether the watchdog has killed it, and its exit status."""
    loop, is_stopped = asyncio.get_running_loop(), False

    def stop(number: signal.Signals) -> None:
        nonlocal is_stopped
        is_stopped = True
        _send(service, number)

    for number in _SIGNALS:
        loop.add_signal_handler(number, stop, number)
    watch = asyncio.create_task(watchdog.watch(service, lambda: _send(service, signal.SIGKILL)))
    try:
        while (status := _ended(service)) is None:  # noqa: ASYNC110 - the system sets no event
            await asyncio.sleep(LOOK_EVERY_S)
    finally:
        watch.cancel()
    was_stuck = watch.done() and not watch.cancelled() and watch.result()
    return was_stuck and not is_stopped, status


def _send(service: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(service, number)


def _ended(service: int) -> int | None:
    """Return the exit status of the service; None while it runs.

    As process 1 of a container this process gets orphans of the service, and frees them.
    """
    while True:
        try:
            process, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return 1
        if process == service:
            return os.waitstatus_to_exitcode(status)
        if process == 0:
            return None
