"""The alert desk: has Alerts raised and cleared in the broker, each state once, however often it is said."""

import asyncio
from collections import OrderedDict
from dataclasses import dataclass

from datamodels.states import Severity
from handover.alerts import PRIORITIES, alert_id, clear_alert, raise_alert
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.rounds import LAST_RETRY_S
from handover.settings import Settings
from handover.telemetry import get_logger
from ros_fiware_bridge.rules.outward import AlertNews

log = get_logger(__name__)

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
        self._waiting: OrderedDict[str, AlertNews] = OrderedDict()
        self._something = asyncio.Event()

    def announce(self, rule: str, news: AlertNews) -> None:
        """Take news that the rule `rule` has; nothing happens if it is known."""
        key = f"{rule} {news.key}"
        state = _State(news.standing, news.severity, news.description if news.standing else "")
        if self._known.get(key) == state:
            return
        self._known[key] = state
        self._known.move_to_end(key)
        self._waiting[key] = news
        while len(self._known) > MOST_KEYS:
            self._known.popitem(last=False)
        self._something.set()

    async def keep(self) -> None:
        """Work until cancelled."""
        while True:
            await self._something.wait()
            self._something.clear()
            while self._waiting:
                key, news = self._waiting.popitem(last=False)
                try:
                    await self._write(key, news)
                except BrokerUnavailable:
                    self._waiting.setdefault(key, news)
                    await asyncio.sleep(LAST_RETRY_S)
                except (BrokerError, ValueError) as error:
                    log.warning("an alert could not be written", alert=key, error=str(error))

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
