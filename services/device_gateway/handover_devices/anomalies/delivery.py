"""Delivery of alarms: each is stored, then the broker gets its Alert, then its process is started.

What was stored is found again after `kill -9` and delivered then; raising an active Alert again and
starting a process with the same key change nothing. While the broker or the orchestrator is away, only the
keys of watches wait. A process that could not be started within `MAX_START_S`, or whose alarm is off again,
is not started: an inspection is of use while there is something to inspect.
"""

import asyncio
import hashlib
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import orjson
from sqlalchemy import Connection

from handover.alerts import alert_id, clear_alert, raise_alert
from handover.alerts.catalogue import DEVICE_ANOMALY
from handover.broker import BrokerClient, BrokerError
from handover.errors import HandoverError, Problem
from handover.messages import Message
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.runtime.retry import Backoff
from handover.security.service_access import ServiceAccess
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.anomalies.monitor import Monitor, Watch, WatchKey
from handover_devices.registry.entities import device_id
from handover_devices.settings import GatewaySettings
from handover_devices.storage import anomaly_store
from handover_devices.storage.history_writer import HistoryWriter

log = get_logger(__name__)

MAX_START_S: Final = 300.0
REQUEST_TIMEOUT_S: Final = 5.0
_TRANSIENT: Final = frozenset({401, 408, 425, 429})
"""Refusals that concern the moment and not the request: the process is started later."""
LEARNED_INTERVAL_S: Final = 60.0
SILENCE_INTERVAL_S: Final = 1.0
MAX_ROWS: Final = 500


class AlarmDelivery:
    """Delivers what the monitor finds; run `run` and `keep_learned` as tasks."""

    def __init__(  # noqa: PLR0917 - wired once, by `app`
        self,
        settings: GatewaySettings,
        monitor: Monitor,
        writer: HistoryWriter,
        broker: BrokerClient,
        credentials: ServiceAccess,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._settings = settings
        self._monitor = monitor
        self._writer = writer
        self._broker = broker
        self._credentials = credentials
        self._clock = clock
        self._http = BodyReadingHttpClient(ca_files=settings.ca_files)
        self._wake = asyncio.Event()
        self._starting: dict[str, Watch] = {}
        monitor.on_changed = self._wake.set

    async def run(self) -> None:
        """Deliver until cancelled."""
        backoff = Backoff()
        while True:
            try:
                async with asyncio.timeout(SILENCE_INTERVAL_S):
                    await self._wake.wait()
            except TimeoutError:
                self._monitor.check_silence()
            self._wake.clear()
            try:
                await self.deliver()
            except (BrokerError, Problem) as error:
                log.warning("alarms wait", error=str(error))
                self._monitor.postpone_first()  # another one may be accepted
                self._wake.set()
                await backoff.wait()
            else:
                backoff.reset()

    async def start_processes(self) -> None:
        """Start processes until cancelled."""
        while True:
            for key, watch in list(self._starting.items()):
                if await self._start_process(watch):
                    self._starting.pop(key, None)
            await asyncio.sleep(1.0)

    async def keep_learned(self) -> None:
        """Store what detectors have learned until cancelled."""
        while True:
            await asyncio.sleep(LEARNED_INTERVAL_S)
            rows = [
                watch.row()
                for watch in self._monitor.watches.values()
                if watch.last_t > float("-inf") and watch.detector.state() is not None
            ]
            try:
                for start in range(0, len(rows), MAX_ROWS):
                    await self._save(rows[start : start + MAX_ROWS])
            except Problem as problem:
                log.warning("learned values not stored", reason=str(problem))

    async def deliver(self) -> None:
        """Deliver what has changed; raise `BrokerError` or `Problem` if some of it has to be repeated."""
        monitor = self._monitor
        while monitor.removed:
            key, was_active = next(iter(monitor.removed.items()))
            if was_active:
                await clear_alert(self._broker, self._settings, key=alert_key(key))
            await self._remove(key)
            monitor.removed.pop(key, None)
            if key in monitor.watches:  # made again meanwhile
                monitor.changed[key] = monitor.watches[key]
        while monitor.changed:
            key, watch = next(iter(monitor.changed.items()))
            await self._save([watch.row()])
            is_on = watch.alarm.is_on
            if is_on:
                await self._raise(watch)
            else:
                await clear_alert(self._broker, self._settings, key=alert_key(watch.key))
            watch.reported = is_on
            await self._save([watch.row()])
            if watch.alarm.is_on == is_on and monitor.changed.get(key) is watch:
                del monitor.changed[key]

    async def _save(self, rows: list[anomaly_store.WatchRow]) -> None:
        def save(connection: Connection) -> None:
            anomaly_store.save_watches(connection, rows)

        await self._writer.call(save)

    async def _remove(self, key: WatchKey) -> None:
        await self._writer.call(lambda connection: anomaly_store.remove_watch(connection, *key))

    async def _raise(self, watch: Watch) -> None:
        await raise_alert(
            self._broker,
            self._settings,
            replace(DEVICE_ANOMALY, severity=watch.rule.severity),
            key=alert_key(watch.key),
            source=device_id(self._settings, watch.key.device),
            description=described(watch),
        )
        log.warning("anomaly", **watch.key._asdict(), measured=watch.measured, limit=watch.limit)
        start = watch.rule.start_process
        if start is not None and (
            watch.process_at is None or watch.changed_at >= watch.process_at + start.cooldown_s
        ):
            self._starting[alert_key(watch.key)] = watch

    async def _start_process(self, watch: Watch) -> bool:
        """Start the process of an alarm; return False if that has to be repeated."""
        start = watch.rule.start_process
        if start is None or not watch.alarm.is_on or self._clock() - watch.changed_at > MAX_START_S:
            metrics.PROCESSES.labels("dropped").inc()
            return True
        entity = alert_id(self._settings, alert_key(watch.key))
        body: dict[str, Any] = {
            "definition": start.definition,
            "key": f"{entity}:{int(watch.changed_at * 1e6)}",
            "parameters": {
                **start.parameters,
                "device": device_id(self._settings, watch.key.device),
                "value": watch.key.value,
                "measured": watch.measured,
                "alert": entity,
            },
        }
        try:
            response = await self._credentials.send(
                self._http,
                "POST",
                f"{self._settings.orchestrator}/processes",
                [("Content-Type", "application/json")],
                orjson.dumps(body),
                timeout_s=REQUEST_TIMEOUT_S,
            )
        except (SendError, OSError, HandoverError) as error:
            log.warning("process not started yet", definition=start.definition, error=str(error))
            return False
        if response.status >= 500 or response.status in _TRANSIENT:
            return False
        is_started = response.status < 300  # 200: the key has started one before
        metrics.PROCESSES.labels("started" if is_started else "refused").inc()
        if not is_started:
            reason = response.body[:500].decode(errors="replace")
            log.error("process refused", definition=start.definition, status=response.status, reason=reason)
            return True
        watch.process_at = watch.changed_at
        await self._save([watch.row()])
        log.info("process started", definition=start.definition, **watch.key._asdict())
        return True


def alert_key(key: WatchKey) -> str:
    """Return the key of the Alert of a watch; the digest distinguishes names that look alike in an id."""
    digest = hashlib.sha256("\0".join(key).encode()).hexdigest()[:8]
    return f"{key.rule} {key.device} {key.value} {digest}"


def described(watch: Watch) -> Message:
    """Return what the Alert of a watch says."""
    name = watch.key.value  # a parameter called "value" would look like a Property in the Alert
    device, rule = watch.key.device, watch.key.rule
    measured, limit = f"{watch.measured:.6g}", f"{watch.limit:.6g}"
    note = f" {watch.rule.description}" if watch.rule.description else ""
    match watch.rule.check.type:
        case "limits":
            return DEVICE_ANOMALY.describe(
                "device.anomaly_limits",
                device=device,
                name=name,
                measured=measured,
                limit=limit,
                rule=rule,
                note=note,
            )
        case "rateOfChange":
            return DEVICE_ANOMALY.describe(
                "device.anomaly_rate",
                device=device,
                name=name,
                measured=measured,
                limit=limit,
                rule=rule,
                note=note,
            )
        case "zScore":
            return DEVICE_ANOMALY.describe(
                "device.anomaly_z_score",
                device=device,
                name=name,
                measured=measured,
                limit=limit,
                rule=rule,
                note=note,
            )
        case "silence":
            return DEVICE_ANOMALY.describe(
                "device.anomaly_silence",
                device=device,
                name=name,
                limit=limit,
                rule=rule,
                note=note,
            )
        case "seasonal":
            return DEVICE_ANOMALY.describe(
                "device.anomaly_seasonal",
                device=device,
                name=name,
                measured=measured,
                limit=limit,
                rule=rule,
                note=note,
            )
