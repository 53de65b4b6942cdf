"""Raises and clears Alerts in the broker; a repeated state is written once."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import partial

from handover.alerts import PRIORITIES, alert_id, clear_alert, raise_alert
from handover.alerts.catalogue import AlertType
from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.service_addresses import ROS_BRIDGE
from handover.settings import Settings
from handover_datamodels.states import Severity
from handover_ros.rules.entity_extractor import AlertState

MAX_KEYS = 5000


@dataclass(frozen=True, slots=True)
class _State:
    active: bool
    severity: str
    description: str


class AlertPublisher:
    """Writes states of Alerts while `run` runs; of each key only the newest state waits."""

    def __init__(self, broker: BrokerClient, settings: Settings) -> None:
        self._broker = broker
        self._settings = settings
        self._known: OrderedDict[str, _State] = OrderedDict()
        self._writer = reporting_writer(ROS_BRIDGE, settings, broker)

    def publish(self, rule: str, alert_state: AlertState) -> None:
        """Queue a state of the rule `rule`, unless it is the last known one."""
        key = f"{rule} {alert_state.key}"
        state = _State(
            alert_state.active, alert_state.severity, alert_state.description if alert_state.active else ""
        )
        if self._known.get(key) == state:
            return
        self._known[key] = state
        self._known.move_to_end(key)
        self._writer.put(key, partial(self._write, key, alert_state))
        while len(self._known) > MAX_KEYS:
            self._known.popitem(last=False)

    async def run(self) -> None:
        """Write until cancelled."""
        await self._writer.run()

    async def _write(self, key: str, alert_state: AlertState) -> None:
        if not alert_state.active:
            await clear_alert(self._broker, self._settings, key=key)
            return
        await raise_alert(
            self._broker,
            self._settings,
            AlertType(alert_state.category, alert_state.sub_category, Severity(alert_state.severity)),
            key=key,
            source=alert_state.about,
            description=alert_state.description,
        )
        written = {
            "severity": alert_state.severity,
            "priority": PRIORITIES[Severity(alert_state.severity)].value,
            "description": alert_state.description,
        }
        await self._broker.append(
            alert_id(self._settings, key),
            {name: {"type": "Property", "value": value} for name, value in written.items()},
        )
