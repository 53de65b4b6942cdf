"""People from the broker: Person entities with a `relativePosition`, in m in the frame of the cell.

The broker is asked five times a second; one that does not answer is a silent sensor. A place counts with its
age. A Person whose place is older than `STALE_S`, or without a place, has vanished, also those who are in the
broker when the tool starts.
"""

import asyncio
import hashlib
import re
import time
from collections.abc import Awaitable, Callable
from datetime import datetime

from pydantic import ValidationError

from handover.broker import BrokerClient
from handover.control.speed_limits import RefusedReport
from handover.errors import HandoverError
from handover.telemetry import get_logger
from handover_datamodels.entities import Person
from handover_datamodels.streams import MAX_PEOPLE, SOURCE_PATTERN, PeopleReport, SeenPerson

log = get_logger(__name__)

SOURCE = "broker"
PERIOD_S = 0.2
STALE_S = 2.0
MAX_AHEAD_S = 1.0
ATTRIBUTE = "relativePosition"
PREFIX = "urn:ngsi-ld:Person:"

Receive = Callable[[PeopleReport], Awaitable[None]]


class PersonEntities:
    """Reads Person entities and gives reports to `receive`."""

    def __init__(self, broker: BrokerClient, receive: Receive) -> None:
        self._broker = broker
        self._receive = receive
        self._is_first = True
        self._is_silent = False

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            try:
                async with asyncio.timeout(PERIOD_S * 2):
                    people = await self._broker.find(Person, attrs=ATTRIBUTE)
                await self._receive(self._report(people, time.time()))
                self._is_silent = False
            except (HandoverError, RefusedReport, TimeoutError, OSError) as error:
                if not self._is_silent:
                    log.warning("places of people not read", reason=str(error) or type(error).__name__)
                self._is_silent = True
            await asyncio.sleep(PERIOD_S)

    def _report(self, persons: list[Person], wall_s: float) -> PeopleReport:
        people = [seen for person in persons if (seen := seen_of(person, wall_s, self._is_first)) is not None]
        self._is_first = False
        if len(people) > MAX_PEOPLE:
            raise RefusedReport(f"{len(people)} people have a place; at most {MAX_PEOPLE} are followed")
        return PeopleReport(source=SOURCE, stamp=wall_s, period=PERIOD_S, people=tuple(people))


def seen_of(person: Person, wall_s: float, with_stale: bool) -> SeenPerson | None:
    """Return a Person as seen; None without a valid place, and for a stale one unless `with_stale`.

    A place without a time, or with one in the future, has no known age: it is stale.
    """
    place = person.relative_position
    if place is None or len(place.value) < 2:
        return None
    observed = place.observed_at
    age_s = wall_s - observed.timestamp() if isinstance(observed, datetime) else STALE_S * 2
    if age_s < -MAX_AHEAD_S:
        age_s = STALE_S * 2
    if age_s > STALE_S and not with_stale:
        return None
    x, y = place.value[:2]
    try:
        return SeenPerson(id=_name(person.id), x=x, y=y, age=min(max(age_s, 0.0), STALE_S * 2))
    except ValidationError:
        return None


def _name(entity_id: str) -> str:
    name = entity_id.removeprefix(PREFIX)
    return name if re.match(SOURCE_PATTERN, name) else hashlib.sha256(entity_id.encode()).hexdigest()[:16]
