"""Station joins: who has joined the station of a glove, as `accounts` says.

The answer of a glove is given by the person who has joined its station (`performedBy`); no client names that
person, and `accounts` proves it. While a glove has no Task, each gesture that is held is sent to `accounts`,
which lets the person join or leave whose gesture it is.
"""

import asyncio
from collections.abc import Mapping
from typing import Any, Final

from handover.errors import UsageError
from handover.runtime.retry import Backoff
from handover.security.authentication import Guard
from handover.security.proofs.performer_proof import performer_proof
from handover.security.service_access import AccountsUnavailable
from handover.telemetry import get_logger

log = get_logger(__name__)

POLL_INTERVAL_S: Final = 1.0
MAX_WAITING: Final = 32
"""Gestures that wait to be sent; further ones are dropped."""


class StationJoins:
    """Follows `accounts`; without accounts nobody has joined anything."""

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self._persons: dict[str, str | None] = {}
        self._held: asyncio.Queue[tuple[str, str]] = asyncio.Queue(MAX_WAITING)
        self._asked = asyncio.Event()

    def person_at(self, glove: str) -> str | None:
        """Return the id of the Person who has joined the station of `glove`."""
        return self._persons.get(glove)

    def held(self, glove: str, gesture: str) -> None:
        """Send a gesture that a glove of a station has held without a Task."""
        if glove in self._persons and not self._held.full():
            self._held.put_nowait((glove, gesture))

    async def proof_of(self, person: str, task: str) -> str | None:
        """Return the proof that `person` performed `task`; None if there is none."""
        return await performer_proof(self._guard, person, task)

    async def follow(self) -> None:
        """Ask `accounts` who has joined, at once after a gesture was sent."""
        backoff = Backoff(max_s=POLL_INTERVAL_S * 5)
        while True:
            if self._guard.has_accounts():
                try:
                    document = await self._guard.access.call("GET", "/station-joins")
                    self._persons = dict(_persons(document))
                    backoff.reset()
                except (AccountsUnavailable, UsageError, KeyError, TypeError) as error:
                    if backoff.failures == 0:
                        log.warning("station joins cannot be read", reason=str(error))
                    self._persons = dict.fromkeys(self._persons)  # nobody is known to be there
                    await backoff.wait()
            self._asked.clear()
            try:
                async with asyncio.timeout(POLL_INTERVAL_S):
                    await self._asked.wait()
            except TimeoutError:
                continue

    async def send(self) -> None:
        """Send the gestures that were held."""
        while True:
            glove, gesture = await self._held.get()
            try:
                body = {"glove": glove, "gesture": gesture}
                await self._guard.access.call("POST", "/station-joins", body)
            except (AccountsUnavailable, UsageError) as error:
                log.warning("a gesture was not sent", glove=glove, reason=str(error))
            self._asked.set()


def _persons(document: Mapping[str, Any]) -> Mapping[str, str | None]:
    return {
        str(glove): None if station["joined"] is None else station["joined"]["person"]
        for station in document["stations"]
        for glove in station["gloves"]
    }
