"""Reports to the broker: Device entities and Alerts about gloves, Tasks and the specification database."""

from typing import Self

from handover.alerts import catalogue as alert_catalogue
from handover.alerts import clear_alert, raise_alert, unshown_key
from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient, BrokerError
from handover.service_addresses import GESTURE_CONTROLLER
from handover.telemetry import get_logger
from handover_gloves import metrics
from handover_gloves.connection.device_entities import DeviceEntities
from handover_gloves.gloves.glove import Glove
from handover_gloves.settings import ControllerSettings
from handover_gloves.specifications.database import DatabaseState

log = get_logger(__name__)


class BrokerReports:
    """Listens to gloves and writes to the broker in the background; an asynchronous context manager."""

    def __init__(self, settings: ControllerSettings, broker: BrokerClient) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = reporting_writer(GESTURE_CONTROLLER, settings, broker, metrics.BROKER_WRITES_REFUSED)
        self.devices = DeviceEntities(settings, broker, self._writer)

    async def __aenter__(self) -> Self:
        await self._writer.__aenter__()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._writer.__aexit__(*error)

    def state_changed(self, glove: Glove) -> None:
        """Update the Device entity."""
        self.devices.update(glove)

    def went_silent(self, glove: Glove) -> None:
        """Raise an Alert: a Task waits for a glove that does not send."""
        log.warning("glove went silent during a task", glove=glove.name)
        self._raise(
            alert_catalogue.GLOVE_SILENT,
            key=f"{glove.name} silent",
            source=self.devices.id_of(glove),
            description=alert_catalogue.GLOVE_SILENT.describe(
                "alert.glove_silent",
                glove=glove.name,
                seconds=f"{self._settings.silence_s:g}",
            ),
        )

    def came_back(self, glove: Glove) -> None:
        """Clear the Alert of silence, also one from before a restart."""
        log.info("glove sends", glove=glove.name)
        self._clear(f"{glove.name} silent")

    def needs_calibration(self, glove: Glove, reason: str) -> None:
        """Raise an Alert: the glove should be calibrated again."""
        log.warning("glove should be calibrated again", glove=glove.name, reason=reason)
        self._raise(
            alert_catalogue.CALIBRATION_NEEDED,
            key=f"{glove.name} fit",
            source=self.devices.id_of(glove),
            description=alert_catalogue.CALIBRATION_NEEDED.describe(
                "alert.calibration_needed",
                glove=glove.name,
                why=reason,
            ),
        )

    def calibration_restored(self, glove: Glove) -> None:
        """Clear the Alert of the calibration."""
        self._clear(f"{glove.name} fit")

    async def cannot_be_shown(self, task_id: str, reason: str) -> None:
        """Raise an Alert: nobody can be asked for the gesture of a Task.

        It is written before this returns, so that it never follows the end of the Task, which clears it.
        While the broker does not accept it, it is left out: the failure of the Task has the same reason.
        """
        try:
            await raise_alert(
                self._broker,
                self._settings,
                alert_catalogue.UNKNOWN_GESTURE,
                key=unshown_key(task_id),
                source=task_id,
                description=reason,
            )
        except BrokerError as error:
            log.warning("alert not written", task=task_id, error=str(error))

    def specification_database_changed(self, state: DatabaseState) -> None:
        """Raise or clear the Alert that the specification database is unavailable."""
        key = "specification database away"
        if state.name != "away":
            self._clear(key)
            return
        self._raise(
            alert_catalogue.SPECIFICATIONS_UNAVAILABLE,
            key=key,
            source=self._settings.entity_id("Device", "specification-database"),
            description=alert_catalogue.SPECIFICATIONS_UNAVAILABLE.describe(
                "alert.specifications_away",
                detail=state.detail,
            ),
        )

    def _raise(self, kind: alert_catalogue.AlertType, *, key: str, source: str, description: str) -> None:
        self._writer.put(
            f"Alert {key}",
            lambda: raise_alert(
                self._broker, self._settings, kind, key=key, source=source, description=description
            ),
        )

    def _clear(self, key: str) -> None:
        self._writer.put(f"Alert {key}", lambda: clear_alert(self._broker, self._settings, key=key))
