"""Waiting until the graph is so: matches are made by other threads and programs, and nobody calls us back."""

import asyncio
from collections.abc import Callable

_STEP_S = 0.01


async def until(holds: Callable[[], bool], timeout_s: float) -> bool:
    """Wait until `holds()`, at most `timeout_s`; return whether it does."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + timeout_s
    while not holds():
        left_s = end_s - loop.time()
        if left_s <= 0:
            return False
        await asyncio.sleep(min(_STEP_S, left_s))
    return True
