"""Waits for a condition by polling: other threads and processes change it without a callback."""

import asyncio
from collections.abc import Callable

_STEP_S = 0.01


async def until(holds: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until `holds()` is true, at most `timeout_s`; return whether it is."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + timeout_s
    while not holds():
        left_s = end_s - loop.time()
        if left_s <= 0:
            return False
        await asyncio.sleep(min(_STEP_S, left_s))
    return True
