"""The seasonal baseline of a series: what is usual at each time of the day or week, from the history.

The mean of each interval of each period is one observation, so that a day with many values weighs as much as
one with few; a baseline has their mean, their standard deviation and their number. Times are UTC.
"""

import asyncio
import math
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Final

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from handover.telemetry import get_logger
from handover_devices.anomalies.detectors import Baseline, Seasonal
from handover_devices.anomalies.monitor import Monitor, WatchKey
from handover_devices.anomalies.rules import SeasonalCheck
from handover_devices.storage import history

log = get_logger(__name__)

REFRESH_S: Final = 3600.0
LOOK_S: Final = 10.0
DAY_S: Final = 86_400
PERIODS_S: Final = {"day": DAY_S, "week": 7 * DAY_S}


def baseline_of(engine: Engine, series: int, check: SeasonalCheck, now_s: float) -> Baseline:
    """Return the baseline of a series; blocks on the database."""
    interval_s = check.interval_min * 60
    period_s = PERIODS_S[check.period]
    end_s = int(now_s // interval_s * interval_s)  # the present interval is not complete
    begin_s = (end_s - check.history_days * DAY_S) // period_s * period_s
    points = history.intervals(engine, series, begin_s * 1_000_000, end_s * 1_000_000, interval_s * 1_000_000)
    by_time: defaultdict[int, list[float]] = defaultdict(list)
    for point in points:
        by_time[int(point.t_us / 1e6 % period_s // interval_s)].append(point.mean)
    return Baseline(period_s, interval_s, {place: _usual(means) for place, means in by_time.items()})


def _usual(means: list[float]) -> tuple[float, float, int]:
    mean = math.fsum(means) / len(means)
    variance = math.fsum((value - mean) ** 2 for value in means) / max(len(means) - 1, 1)
    return mean, math.sqrt(variance), len(means)


async def keep_baselines(engine: Engine, monitor: Monitor, clock: Callable[[], float] = time.time) -> None:
    """Compute the baselines of seasonal rules, each again every hour, until cancelled."""
    computed: dict[WatchKey, float] = {}
    while True:
        computed = {key: at for key, at in computed.items() if key in monitor.watches}
        for key, watch in list(monitor.watches.items()):
            detector = watch.detector
            is_due = time.monotonic() - computed.get(key, -math.inf) > REFRESH_S
            if not isinstance(detector, Seasonal) or not (is_due or detector.baseline is None):
                continue
            try:
                detector.baseline = await asyncio.to_thread(
                    _computed, engine, key.device, key.value, detector.check, clock()
                )
            except SQLAlchemyError as error:
                log.warning("baseline not computed", error=str(error).splitlines()[0], **key._asdict())
                break
            computed[key] = time.monotonic()
        await asyncio.sleep(LOOK_S)


def _computed(engine: Engine, device: str, value: str, check: SeasonalCheck, now_s: float) -> Baseline:
    series = history.series_of(engine, device).get(value)
    if series is None:
        return Baseline(PERIODS_S[check.period], check.interval_min * 60, {})
    return baseline_of(engine, series, check, now_s)
