"""Garbage: how often Python looks for what is of no use any more and does not notice by itself.

Requests leave next to nothing behind in circles, and entities are many and stay. With Python's own numbers
(700, 10, 10) looking through them took a sixth of the time of a change.
"""

import gc
from typing import Final

COLLECTIONS: Final = (20_000, 20, 50)
"""After how many new objects the youngest are looked through, and how much more rarely the older ones."""


def look_rarely() -> None:
    """Collect rarely from now on, and never walk through what is there by now: it was loaded to stay."""
    gc.set_threshold(*COLLECTIONS)
    gc.freeze()
