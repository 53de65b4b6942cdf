"""The Device entities of gloves in the broker."""

from datetime import UTC, datetime
from typing import Any

from handover.broker import BrokerClient
from handover.broker.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from handover_datamodels.times import iso
from handover_gloves.gloves.glove import Glove


class DeviceEntities:
    """Writes the Device entity of a glove when it has changed, without delaying frames."""

    def __init__(self, settings: Settings, broker: BrokerClient, writer: LatestValueWriter) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = writer
        self._written: dict[str, tuple[Any, ...]] = {}

    def id_of(self, glove: Glove) -> str:
        """Return the id of the Device entity of `glove`."""
        return self._settings.entity_id("Device", glove.name)

    def update(self, glove: Glove, *, force: bool = False) -> None:
        """Write the Device entity of `glove` soon if it has changed, or in any case with `force`."""
        now = (glove.device_state, glove.responder.command, glove.connection.battery)
        if force or self._written.get(glove.name) != now:
            self._written[glove.name] = now
            self._writer.put(f"Device {glove.name}", lambda: self._broker.upsert([self._entity(glove)]))

    def forget(self, glove: Glove) -> None:
        """Forget what was written of `glove`; its entity stays in the broker."""
        self._written.pop(glove.name, None)

    def _entity(self, glove: Glove) -> dict[str, Any]:
        entity: dict[str, Any] = {
            "id": self.id_of(glove),
            "type": "Device",
            "category": _property(["glove"]),
            "controlledProperty": _property(["gesture"]),
            "deviceState": _property(glove.device_state, datetime.now(UTC)),
        }
        if glove.responder.command is not None:
            command_id, given_at = glove.responder.command
            entity["commandId"] = _property(command_id, given_at)
        if glove.connection.battery is not None:
            entity["batteryLevel"] = _property(round(glove.connection.battery, 2), datetime.now(UTC))
        return entity


def _property(value: Any, observed_at: datetime | None = None) -> dict[str, Any]:
    written = {"type": "Property", "value": value}
    return {**written, "observedAt": iso(observed_at)} if observed_at else written
