"""The record of the limits of a robot in the broker: a SpeedLimit for each source, and an Alert.

The robot never waits for the broker: the latest values are written in the background, once a second at most.
"""

import asyncio
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Any, Self

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import ROBOT_STOPPED_BY_LIMIT
from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.settings import Settings
from handover_datamodels.streams import SpeedLimitReport
from handover_datamodels.times import iso
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.metrics import DEVICE_WRITES_REJECTED

WRITE_EVERY_S = 1.0
DEAD_BAND = 0.02
REFRESH_S = 5.0
"""An unchanged limit is written this often, since it is valid for a time only."""


class LimitRecords:
    """Writes the limits of the robot with the Device `device`; an asynchronous context manager."""

    def __init__(self, settings: Settings, limits: RobotLimits, device: str, broker: BrokerClient) -> None:
        self._settings = settings
        self._limits = limits
        self._device = device
        self._broker = broker
        self._writer = reporting_writer("trajectory-tool", settings, broker, DEVICE_WRITES_REJECTED)
        self._written: dict[str, tuple[float, float]] = {}
        self._has_alert: bool | None = None
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        await self._writer.__aenter__()
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
        await self._writer.__aexit__()

    async def _run(self) -> None:
        while True:
            self._write()
            await asyncio.sleep(WRITE_EVERY_S)

    def _write(self) -> None:
        now_s = asyncio.get_running_loop().time()
        for report in self._limits.body.reports():
            fraction, written_s = self._written.get(report.source, (-1.0, 0.0))
            if abs(fraction - report.fraction) < DEAD_BAND and now_s - written_s < REFRESH_S:
                continue
            self._written[report.source] = report.fraction, now_s
            entity = self._entity(report)
            self._writer.put(entity["id"], lambda entity=entity: self._broker.upsert([entity]))  # type: ignore[misc]
        self._write_alert()

    def _write_alert(self) -> None:
        stopping = [allowed for allowed in self._limits.allowed() if allowed.needs_reset]
        lost = self._limits.state.lost
        has_alert = bool(stopping or lost)
        if has_alert == self._has_alert or (not has_alert and self._has_alert is None):
            return
        self._has_alert = has_alert
        key = f"{self._limits.name} stopped by limit"
        if not has_alert:
            self._writer.put(key, lambda: clear_alert(self._broker, self._settings, key=key))
            return
        reason = "; ".join([*(f"{allowed.rule}: {allowed.reason}" for allowed in stopping), *lost])
        description = ROBOT_STOPPED_BY_LIMIT.describe(
            "robot.stopped_by_limit",
            robot=self._limits.name,
            reason=reason,
        )

        async def write() -> None:
            await raise_alert(
                self._broker,
                self._settings,
                ROBOT_STOPPED_BY_LIMIT,
                key=key,
                source=self._device,
                description=description,
            )

        self._writer.put(key, write)

    def _entity(self, report: SpeedLimitReport) -> dict[str, Any]:
        now = datetime.now(UTC)
        until = iso(now + timedelta(seconds=report.timeout))
        entity: dict[str, Any] = {
            "id": self._settings.entity_id("SpeedLimit", f"{self._limits.name}-{report.source}"),
            "type": "SpeedLimit",
            "refRobot": {"type": "Relationship", "object": self._device},
            "fraction": {"type": "Property", "value": report.fraction, "observedAt": iso(now)},
            "reason": {"type": "Property", "value": report.reason},
            "validUntil": {"type": "Property", "value": {"@type": "DateTime", "@value": until}},
        }
        if report.person is not None:
            entity["refPerson"] = {"type": "Relationship", "object": report.person}
        if report.max_speed is not None:
            entity["maxSpeed"] = {"type": "Property", "value": report.max_speed, "unitCode": "MTS"}
        return entity
