"""What the system may grant a control cycle: a real-time priority, and memory that is never paged."""

import ctypes
import gc
import os

from handover.telemetry import get_logger

log = get_logger(__name__)

FIFO_PRIORITY = 80
_MCL_CURRENT, _MCL_FUTURE = 1, 2


def use_real_time(*, fifo: bool = True) -> dict[str, bool]:
    """Ask for SCHED_FIFO and locked memory, and log what was refused; return what was granted."""
    granted = {"fifo": fifo and _use_fifo(), "locked_memory": _lock_memory()}
    if fifo and not granted["fifo"]:
        log.warning("no real-time priority; cycles may be late", remedy="ulimit -r 80, or CAP_SYS_NICE")
    if not granted["locked_memory"]:
        log.warning("memory is not locked; a page fault may delay a cycle", remedy="ulimit -l unlimited")
    return granted


def stop_collecting() -> None:
    """Turn the garbage collection off; what exists is kept. Reference counts still free the rest."""
    gc.collect()
    gc.freeze()
    gc.disable()


def _use_fifo() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


def _lock_memory() -> bool:
    try:
        library = ctypes.CDLL(None, use_errno=True)
        return bool(library.mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0)
    except (AttributeError, OSError):
        return False
