"""Keeps what was loaded out of the garbage collection, for services whose event loop must not pause.

A full collection visits every object: with numerical libraries it takes some 100 ms, in which nothing else
happens. Modules are imported when they are first needed, so they are frozen whenever new ones have come: one
collection then, and later ones visit only what was made since.
"""

import asyncio
import gc
import sys
from typing import Final

CHECK_EVERY_S: Final = 5.0


async def freeze_loaded(check_every_s: float = CHECK_EVERY_S) -> None:
    """Freeze all objects whenever modules were loaded, until cancelled."""
    count = 0
    while True:
        if len(sys.modules) != count:
            count = len(sys.modules)
            gc.collect()
            gc.freeze()
        await asyncio.sleep(check_every_s)
