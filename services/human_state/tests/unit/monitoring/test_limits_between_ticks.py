"""A heart rate that lowers the limit reaches the readers without a tick."""

import asyncio
import time
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.service_access import ServiceAccess
from handover_body.fusion.baseline import Baseline
from handover_body.model.signals import Samples, SignalInfo, SignalKind
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.processors import pipeline_of
from handover_body.people.consent import Purpose
from handover_body.people.people import People, now_us
from handover_body.settings import HumanStateSettings
from handover_body.storage import tables
from handover_body.storage.store import SensorRow, Store

RATE = SignalInfo(SignalKind.HEART_RATE, "BPM", None, method="chest strap")
SENSOR = SensorRow("strap", "max30100", {"port": 0}, "aino")


def rate(bpm: float, at_s: float) -> Samples:
    return Samples("strap", RATE, at_s, np.array([[bpm]]), np.array([at_s]))


async def test_a_limit_that_falls_is_published_at_once_and_a_rise_waits_for_a_tick(tmp_path: Path) -> None:
    settings = HumanStateSettings.load(data_dir=tmp_path)
    engine = connect(f"sqlite:///{tmp_path / 'human-state.db'}")
    tables.prepare(engine)
    people = People(Store(engine))
    await people.put("aino", Baseline(60.0, 180.0), (90.0, 125.0, 0.2))
    purposes = frozenset({Purpose.LIVE, Purpose.SPEED_LIMITS})
    await people.consent("aino", purposes, now_us() + 3_600_000_000, "Aino")
    await people.put_sensor(SENSOR)
    access = ServiceAccess(settings, "human-state")
    async with BackgroundTasks("test") as tasks:
        monitoring = Monitoring(
            settings, people, access, tasks, pipeline_of=pipeline_of, classifier_of=lambda: None
        )
        monitoring.apply("aino")
        monitor = monitoring.monitors["aino"]
        now_s = time.time()
        for second in range(6):
            monitor.take(rate(70.0, now_s - 6 + second))
        await asyncio.sleep(0)
        assert monitoring.sequence == 0, "nothing fell, and no tick was computed"
        before = monitor.limit.fraction
        assert before > 0.2

        monitor.take(rate(130.0, now_s - 0.1))
        monitor.take(rate(130.0, now_s))
        limits: dict[str, Any] = orjson.loads(await monitoring.next_limits(0))
        assert limits["sequence"] == monitoring.sequence
        assert limits["limits"][0]["fraction"] < before
        assert not monitor.person.robots
    access.close()
    engine.dispose()
