"""All parts of the anomalies together: rules, monitor, delivery, baselines."""

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial

from pydantic import ValidationError
from sqlalchemy import Engine

from handover.broker import BrokerClient
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_devices.anomalies.baseline import keep_baselines
from handover_devices.anomalies.delivery import AlarmDelivery
from handover_devices.anomalies.monitor import Monitor
from handover_devices.anomalies.rules import Rule, read_rules
from handover_devices.settings import GatewaySettings
from handover_devices.storage import anomaly_store
from handover_devices.storage.history_writer import HistoryWriter

log = get_logger(__name__)


class Anomalies:
    """Watches the values of devices; raises `UsageError` if the file of rules is invalid."""

    def __init__(
        self,
        settings: GatewaySettings,
        engine: Engine,
        writer: HistoryWriter,
        broker: BrokerClient,
        credentials: ServiceAccess,
    ) -> None:
        file = settings.device_rules
        self.in_file = read_rules(file) if file is not None else {}
        self.monitor = Monitor()
        self.delivery = AlarmDelivery(settings, self.monitor, writer, broker, credentials)
        self._engine = engine

    async def load(self) -> None:
        """Use the stored rules, those of the file, and the state of an earlier run."""
        self.monitor.load(await asyncio.to_thread(anomaly_store.watches, self._engine))
        for name, text in (await asyncio.to_thread(anomaly_store.rules, self._engine)).items():
            try:
                self.monitor.set_rule(name, Rule.model_validate_json(text))
            except ValidationError as error:
                log.warning("stored rule not used", rule=name, error=str(error))
        for name, rule in self.in_file.items():
            self.monitor.set_rule(name, rule)

    def work(self) -> tuple[Callable[[], Awaitable[None]], ...]:
        """Return what has to run as tasks, after all devices were set."""
        self.monitor.discard_unknown()
        delivery = self.delivery
        baselines = partial(keep_baselines, self._engine, self.monitor)
        return delivery.run, delivery.start_processes, delivery.keep_learned, baselines
