"""The HumanState of each person who allows it, in the broker: at most once a second, with dead bands."""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any, Final

from datamodels.times import iso
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from handover.telemetry import get_logger
from services.human_state.fusion.person_state import FusedValue
from services.human_state.model.features import UNITS, Feature, FeatureName, Status
from services.human_state.monitoring.monitoring import Monitoring
from services.human_state.monitoring.person_monitor import PersonMonitor
from services.human_state.people.consent import Purpose
from services.human_state.people.people import People

log = get_logger(__name__)

WRITE_EVERY_S: Final = 1.0
REFRESH_S: Final = 30.0
"""A value within its dead band is written this often."""
DEAD_BANDS: Final[Mapping[FeatureName, float]] = {
    FeatureName.HEART_RATE: 1.0,
    FeatureName.BREATHING_RATE: 0.5,
    FeatureName.HRV_RMSSD: 2.0,
    FeatureName.SPO2: 0.5,
    FeatureName.EDA_TONIC: 0.1,
    FeatureName.SKIN_TEMPERATURE: 0.1,
    FeatureName.MOVEMENT: 0.05,
    FeatureName.EXERTION_LEVEL: 0.02,
}
ATTRIBUTES: Final = frozenset(
    {
        FeatureName.HEART_RATE,
        FeatureName.BREATHING_RATE,
        FeatureName.HRV_RMSSD,
        FeatureName.SPO2,
        FeatureName.EDA_TONIC,
        FeatureName.SKIN_TEMPERATURE,
        FeatureName.MOVEMENT,
        FeatureName.ACTIVITY,
        FeatureName.POSTURE,
        FeatureName.WEAR_STATE,
        FeatureName.EXERTION_LEVEL,
    }
)
"""The attributes of a HumanState; other features stay in this service."""


def entity_id(settings: Settings, monitor: PersonMonitor) -> str:
    """Return the id of the HumanState of a person; it has the pseudonym."""
    return settings.entity_id("HumanState", monitor.person.pseudonym)


class HumanStates:
    """Writes the entities, and deletes them when the consent ends."""

    def __init__(
        self, settings: Settings, monitoring: Monitoring, broker: BrokerClient, writer: LatestValueWriter
    ) -> None:
        self._settings = settings
        self._monitoring = monitoring
        self._broker = broker
        self._writer = writer
        self._written: dict[str, dict[FeatureName, tuple[FusedValue, float]]] = {}

    async def run(self) -> None:
        """Write until cancelled."""
        while True:
            for monitor in list(self._monitoring.monitors.values()):
                if Purpose.BROKER in monitor.person.purposes():
                    self._write(monitor)
                elif entity_id(self._settings, monitor) in self._written:
                    self.ended(monitor)
            await asyncio.sleep(WRITE_EVERY_S)

    def _write(self, monitor: PersonMonitor) -> None:
        now_s = time.monotonic()
        identifier = entity_id(self._settings, monitor)
        before = self._written.setdefault(identifier, {})
        values = [value for value in monitor.values(now_s) if value.name in ATTRIBUTES]
        if not any(_has_changed(value, before.get(value.name), now_s) for value in values):
            return
        self._written[identifier] = {value.name: (value, now_s) for value in values}
        entity = self.entity(monitor, values, now_s)
        self._writer.put(identifier, lambda: self._broker.upsert([entity]))

    def entity(self, monitor: PersonMonitor, values: list[FusedValue], now_s: float) -> dict[str, Any]:
        """Return the HumanState; the fused value is the default instance, one more for each sensor."""
        offset_s = time.time() - now_s
        entity: dict[str, Any] = {
            "id": entity_id(self._settings, monitor),
            "type": "HumanState",
            "refPerson": {
                "type": "Relationship",
                "object": self._settings.entity_id("Person", monitor.person.name),
            },
        }
        for value in values:
            method = "fused" if len(value.sensors) > 1 else value.method
            instances = [_instance(value.name, value, method, offset_s)]
            instances += [self._of_sensor(each, offset_s) for each in value.sensors]
            entity[value.name.value] = instances
        return entity

    def _of_sensor(self, feature: Feature, offset_s: float) -> dict[str, Any]:
        observed = {
            "type": "Relationship",
            "object": self._settings.entity_id("Device", feature.source),
        }
        return {
            **_instance(feature.name, feature, feature.method, offset_s),
            "datasetId": f"urn:ngsi-ld:Dataset:{feature.source}",
            "observedBy": observed,
        }

    def ended(self, monitor: PersonMonitor) -> None:
        """Delete the entity of a person whose consent has ended."""
        self.delete(monitor.person.pseudonym)

    def delete(self, pseudonym: str) -> None:
        """Delete the HumanState of a pseudonym with its history, as soon as the broker answers."""
        identifier = self._settings.entity_id("HumanState", pseudonym)
        self._written.pop(identifier, None)

        async def delete() -> None:
            with suppress(NotFound):
                await self._broker.delete(identifier)
            try:
                await self._broker.delete_evolution(identifier)
            except BrokerUnavailable:
                raise
            except BrokerError as error:
                if not isinstance(error, NotFound):
                    log.warning("history of a HumanState is kept by the broker", error=str(error))

        self._writer.put(identifier, delete)

    async def delete_orphans(self, people: People) -> None:
        """Delete entities of persons who were deleted, or whose consent ended, while this did not run."""
        allowed = {one.pseudonym for one in people.all() if Purpose.BROKER in one.purposes()}
        prefix = self._settings.entity_id("HumanState", "P-").removesuffix("P-")
        for entity in await self._broker.query(type="HumanState"):
            pseudonym = str(entity["id"]).removeprefix(prefix)
            if pseudonym.startswith("P-") and pseudonym not in allowed:
                self.delete(pseudonym)


def _has_changed(value: FusedValue, before: tuple[FusedValue, float] | None, now_s: float) -> bool:
    if before is None or before[0].status is not value.status or now_s - before[1] >= REFRESH_S:
        return True
    if isinstance(value.value, str) or isinstance(before[0].value, str):
        return value.value != before[0].value
    return abs(value.value - before[0].value) > DEAD_BANDS.get(value.name, 0.0)


def _instance(name: FeatureName, value: FusedValue | Feature, method: str, offset_s: float) -> dict[str, Any]:
    number = value.value if isinstance(value.value, str) else round(value.value, 3)
    status = value.status if value.is_calibrated or value.status is not Status.VALID else Status.IMPLAUSIBLE
    instance: dict[str, Any] = {
        "type": "Property",
        "value": number,
        "observedAt": iso(datetime.fromtimestamp(value.at_s + offset_s, UTC)),
        "quality": {"type": "Property", "value": round(value.quality, 3)},
        "status": {"type": "Property", "value": status.value},
    }
    if method:
        instance["method"] = {"type": "Property", "value": method}
    if name in UNITS:
        instance["unitCode"] = UNITS[name]
    return instance
