"""Unfinished count: whether the broker has as many unfinished entities as the orchestrator expects.

A broker counts them without sending them, so that they are listed only if their number is not the expected
one. Entities of others are expected once a listing has shown them. Changes that cancel each other out are
found by the next listing, which is at the latest after `max_age_s`. A broker that does not count, or
refuses to, is asked for the list every time.
"""

import asyncio

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.tasks.task_life import UNFINISHED_QUERY


class UnfinishedCount:
    """The unfinished entities of one type."""

    def __init__(self, broker: BrokerClient, type_: str, max_age_s: float) -> None:
        self._broker = broker
        self._type = type_
        self._max_age_s = max_age_s
        self._foreign: int | None = None
        """How many entities of others the last listing has shown; None: list them."""
        self._list_at_s = 0.0

    async def is_as_expected(self, own: int) -> bool:
        """Return whether the number is that of the orchestrator's `own` entities and the known others."""
        if self._foreign is None or asyncio.get_running_loop().time() >= self._list_at_s:
            return False
        try:
            counted = await self._broker.count(type=self._type, q=UNFINISHED_QUERY)
        except BrokerUnavailable:
            raise
        except BrokerError:
            return False
        return counted == own + self._foreign

    def note(self, foreign: int) -> None:
        """Note how many entities of others a listing has shown."""
        self._foreign = foreign
        self._list_at_s = asyncio.get_running_loop().time() + self._max_age_s

    def forget(self) -> None:
        """Require a listing: something may have been missed."""
        self._foreign = None
