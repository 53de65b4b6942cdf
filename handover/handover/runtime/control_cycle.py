"""The mark of functions that run in a control cycle, in the control thread or the control process of a robot.

A cycle has a few milliseconds, and what it commands is late where it waits: for an event loop, a disk, a
network or a log. So a marked function is no coroutine, opens nothing, does not log in a loop, and sleeps by
the clock of its cycle only. A coroutine hands it to the control thread and does not call it. A test reads the
source of all marked functions (`tests/unit/kit/test_control_cycles.py`).
"""

from collections.abc import Callable
from typing import Any, Final, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

MARK: Final = "runs_in_cycle"
"""The attribute of a marked function."""


def runs_in_cycle(function: Function) -> Function:
    """Mark a function that runs in a control cycle; calls cost nothing more."""
    setattr(function, MARK, True)
    return function
