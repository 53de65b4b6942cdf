"""The Device entity of a glove: kept current in the broker, without ever holding up a frame."""

from datetime import UTC, datetime
from typing import Any

from datamodels.times import iso
from handover.broker import BrokerClient
from handover.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from services.gesture_controller.glove import Glove


class Devices:
    """Writes the Device entities of gloves, when something about them has changed."""

    def __init__(self, settings: Settings, broker: BrokerClient, writer: LatestValueWriter) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = writer
        self._told: dict[str, tuple[Any, ...]] = {}

    def id_of(self, glove: Glove) -> str:
        """Return the id of the Device entity of `glove`."""
        return self._settings.entity_id("Device", glove.name)

    def tell(self, glove: Glove, *, again: bool = False) -> None:
        """Have the Device entity of `glove` written if it is another than the last; `again`: in any case."""
        now = (glove.device_state, glove.command, glove.battery)
        if again or self._told.get(glove.name) != now:
            self._told[glove.name] = now
            self._writer.put(f"Device {glove.name}", lambda: self._broker.upsert([self._entity(glove)]))

    def forget(self, glove: Glove) -> None:
        """Forget what was last written of `glove`; its entity stays, as that of a glove that is away."""
        self._told.pop(glove.name, None)

    def _entity(self, glove: Glove) -> dict[str, Any]:
        entity: dict[str, Any] = {
            "id": self.id_of(glove),
            "type": "Device",
            "category": _property(["glove"]),
            "controlledProperty": _property(["gesture"]),
            "deviceState": _property(glove.device_state, datetime.now(UTC)),
        }
        if glove.command is not None:
            command_id, given_at = glove.command
            entity["commandId"] = _property(command_id, given_at)
        if glove.battery is not None:
            entity["batteryLevel"] = _property(round(glove.battery, 2), datetime.now(UTC))
        return entity


def _property(value: Any, observed_at: datetime | None = None) -> dict[str, Any]:
    written = {"type": "Property", "value": value}
    return {**written, "observedAt": iso(observed_at)} if observed_at else written
