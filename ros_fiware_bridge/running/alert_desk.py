"""The alert desk: has Alerts raised and cleared in the broker, each state once, however often it is said."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import partial

from datamodels.states import Severity
from handover.alerts import PRIORITIES, alert_id, clear_alert, raise_alert
from handover.broker import BrokerClient
from handover.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from ros_fiware_bridge.rules.outward import AlertNews

MOST_KEYS = 5000


@dataclass(frozen=True, slots=True)
class _State:
    standing: bool
    severity: str
    description: str


class AlertDesk:
    """Works through news of Alerts while `keep` runs; of each key only the newest waits."""

    def __init__(self, broker: BrokerClient, settings: Settings) -> None:
        self._broker = broker
        self._settings = settings
        self._known: OrderedDict[str, _State] = OrderedDict()
        self._writer = LatestValueWriter()

    def announce(self, rule: str, news: AlertNews) -> None:
        """Take news that the rule `rule` has; nothing happens if it is known."""
        key = f"{rule} {news.key}"
        state = _State(news.standing, news.severity, news.description if news.standing else "")
        if self._known.get(key) == state:
            return
        self._known[key] = state
        self._known.move_to_end(key)
        self._writer.put(key, partial(self._write, key, news))
        while len(self._known) > MOST_KEYS:
            self._known.popitem(last=False)

    async def keep(self) -> None:
        """Work until cancelled."""
        await self._writer.run()

    async def _write(self, key: str, news: AlertNews) -> None:
        if not news.standing:
            await clear_alert(self._broker, self._settings, key=key)
            return
        await raise_alert(
            self._broker,
            self._settings,
            key=key,
            source=news.about,
            category=news.category,
            sub_category=news.sub_category,
            severity=news.severity,
            description=news.description,
        )
        written = {
            "severity": news.severity,
            "priority": PRIORITIES[Severity(news.severity)].value,
            "description": news.description,
        }
        await self._broker.append(
            alert_id(self._settings, key),
            {name: {"type": "Property", "value": value} for name, value in written.items()},
        )
