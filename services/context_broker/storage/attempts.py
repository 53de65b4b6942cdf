"""Attempts: an operation that another broker has overtaken is carried out again from its start.

Only brokers that share a database meet this; it is not the asker's business until it happens again and again.
"""

import asyncio
import random
from collections.abc import Awaitable, Callable
from typing import Final, TypeVar

from handover.errors import Problem
from services.context_broker.api.problems import too_busy
from services.context_broker.storage.replica import Overtaken

MOST_ATTEMPTS: Final = 60
LONGEST_PAUSE_S: Final = 0.1
"""Before the last attempt; before the others less, so that two brokers do not meet again and again."""

T = TypeVar("T")


def was_overtaken(error: BaseException) -> bool:
    """Say whether this is, or comes from, another broker's having been quicker."""
    return isinstance(error, Overtaken) or isinstance(error.__cause__, Overtaken)


async def made_again(act: Callable[[], Awaitable[T]]) -> T:
    """Return what `act` returns once nobody is quicker; raise a problem (503) if somebody always is."""
    for attempt in range(1, MOST_ATTEMPTS):
        await asyncio.sleep(random.uniform(0, LONGEST_PAUSE_S * attempt / MOST_ATTEMPTS))  # noqa: S311
        try:
            return await act()
        except (Overtaken, Problem) as error:
            if not was_overtaken(error):
                raise
    raise too_busy(
        f"other brokers on the same database changed what this is about {MOST_ATTEMPTS} times in a row; "
        "send it again in a moment"
    )
