"""The HumanState of each person who allows it, in the broker: at most once a second, with dead bands."""

import asyncio
import time
from dataclasses import replace
from typing import Final

from handover.broker.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_body.exchange.deletions import Deletions
from handover_body.exchange.health_entities import HealthEntities
from handover_body.exchange.ngsi_ld import OF_PERSON, EntityThrottle, human_state
from handover_body.fusion.person_state import FusedValue
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.people.consent import Purpose
from handover_body.people.people import People
from handover_datamodels import HumanState

log = get_logger(__name__)

CHECK_EVERY_S: Final = 0.25
FORGET_EVERY_S: Final = 60.0
"""The broker keeps the history of a person who does not allow it for no longer than this."""


def entity_id(settings: Settings, monitor: PersonMonitor) -> str:
    """Return the id of the HumanState of a person; it has the pseudonym."""
    return settings.entity_id("HumanState", monitor.person.pseudonym)


class HumanStates:
    """Writes the entities, and deletes them when the consent ends."""

    def __init__(
        self,
        settings: Settings,
        monitoring: Monitoring,
        health: HealthEntities,
        writer: LatestValueWriter,
        deletions: Deletions,
    ) -> None:
        self._settings = settings
        self._monitoring = monitoring
        self._health = health
        self._writer = writer
        self._deletions = deletions
        self._throttles: dict[str, EntityThrottle] = {}

    async def run(self) -> None:
        """Write until cancelled."""
        forgot_s = 0.0
        while True:
            if time.monotonic() - forgot_s >= FORGET_EVERY_S:
                forgot_s = time.monotonic()
                self._forget_histories()
            for monitor in list(self._monitoring.monitors.values()):
                if Purpose.BROKER in monitor.person.purposes():
                    self._write(monitor)
                elif entity_id(self._settings, monitor) in self._throttles:
                    self.ended(monitor)
            await asyncio.sleep(CHECK_EVERY_S)

    def _forget_histories(self) -> None:
        """Delete the history of those who allow entities in the broker, but no history of them."""
        for monitor in self._monitoring.monitors.values():
            purposes = monitor.person.purposes()
            if Purpose.BROKER in purposes and Purpose.BROKER_HISTORY not in purposes:
                self._deletions.forget_history(entity_id(self._settings, monitor))

    def _write(self, monitor: PersonMonitor) -> None:
        now_s = time.monotonic()
        identifier = entity_id(self._settings, monitor)
        throttle = self._throttles.setdefault(identifier, EntityThrottle())
        if not throttle.is_open(now_s):
            return
        values = [value for value in monitor.values(now_s) if value.name in OF_PERSON]
        if not values:
            return
        entity = self.entity(monitor, values, now_s)
        if throttle.offer(entity, now_s) is not None:
            self._writer.put(identifier, lambda: self._health.upsert(entity.to_normalized()))

    def entity(self, monitor: PersonMonitor, values: list[FusedValue], now_s: float) -> HumanState:
        """Return the HumanState; the fused value is the default instance, one more for each sensor."""
        offset_s = time.time() - now_s
        sources = {sensor.source for value in values for sensor in value.sensors}
        return human_state(
            entity_id(self._settings, monitor),
            self._settings.entity_id("Person", monitor.person.name),
            [_written(value, offset_s) for value in values],
            {source: self._settings.entity_id("Device", source) for source in sources},
        )

    def ended(self, monitor: PersonMonitor) -> None:
        """Delete the entity of a person whose consent has ended."""
        self.delete(monitor.person.pseudonym)

    def delete(self, pseudonym: str) -> None:
        """Delete the HumanState of a pseudonym with its history, as soon as the broker answers."""
        identifier = self._settings.entity_id("HumanState", pseudonym)
        self._throttles.pop(identifier, None)
        self._deletions.put(identifier)

    async def delete_orphans(self, people: People) -> None:
        """Delete entities of persons who were deleted, or whose consent ended, while this did not run."""
        allowed = {person.pseudonym for person in people.all() if Purpose.BROKER in person.purposes()}
        prefix = self._settings.entity_id("HumanState", "P-").removesuffix("P-")
        for entity in await self._health.broker.query(type="HumanState"):
            pseudonym = str(entity["id"]).removeprefix(prefix)
            if pseudonym.startswith("P-") and pseudonym not in allowed:
                self.delete(pseudonym)


def _written(value: FusedValue, offset_s: float) -> FusedValue:
    """Return a value with its time since 1970 and without digits that nobody measured."""
    return replace(
        value,
        value=_rounded(value.value),
        at_s=value.at_s + offset_s,
        quality=round(value.quality, 3),
        method="fused" if len(value.sensors) > 1 else value.method,
        sensors=tuple(
            replace(
                sensor,
                value=_rounded(sensor.value),
                at_s=sensor.at_s + offset_s,
                quality=round(sensor.quality, 3),
            )
            for sensor in value.sensors
        ),
    )


def _rounded(value: float | str) -> float | str:
    return value if isinstance(value, str) else round(value, 3)
