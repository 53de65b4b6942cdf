"""Runs a sensor driver for as long as the sensor is wanted.

    driver > SensorRunner > SignalMonitor, one a signal > sink of the service

The runner opens the connection again with backoff when it is lost or silent; each `run` of a driver
subscribes from the start. It stamps what arrives, passes it through the monitors, and reports the link, each
change once. Our times are `wall_s`; if our clock is set, the monitors start again and report a clock jump.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from handover.messages import Message, message, text_of
from handover.runtime.retry import Backoff
from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.base import LinkLost, SensorDriver, Sink
from handover_body.model.signals import (
    EYE_EVENTS,
    EYE_STREAMS,
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
)

log = logging.getLogger(__name__)

INITIAL_RECONNECT_S: Final = 0.5
MAX_RECONNECT_S: Final = 15.0
MIN_STABLE_S: Final = 10.0
"""A connection with samples for this long has succeeded: the next attempt after it comes soon."""
WATCH_S: Final = 0.1
MAX_WALL_STEP_S: Final = 0.5
"""Our clock was set if it differs by more from the monotonic one than before."""
MAX_LATE_S: Final = 0.2
"""This machine is busy if it looks after a sensor later than this."""
MAX_TEXT: Final = 500


@dataclass(frozen=True, slots=True)
class RunnerTiming:
    """The delays of a runner; tests shorten them."""

    initial_reconnect_s: float = INITIAL_RECONNECT_S
    max_reconnect_s: float = MAX_RECONNECT_S
    watch_s: float = WATCH_S
    max_silence_s: float | None = None
    """Overrides that of the driver."""


class SensorRunner:
    """One driver and what is known of its link. `run` returns when the driver ends, else when cancelled."""

    def __init__(
        self,
        driver: SensorDriver,
        sink: Sink,
        *,
        timing: RunnerTiming | None = None,
        wall_s: Callable[[], float] = time.time,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.driver: Final = driver
        self.link: LinkState | None = None
        self.battery: float | None = None
        self.has_contact: bool | None = None
        self.connections = 0
        """Connections that have sent samples."""
        self._sink = sink
        self._timing = timing or RunnerTiming()
        self._wall_s = wall_s
        self._monotonic_s = monotonic_s
        self._monitors = {info: self._monitor(info) for info in driver.signals}
        self._wall_ahead_s = wall_s() - monotonic_s()
        self._active_at: float | None = None  # monotonic; the connection, or the last samples
        self._has_samples = False
        self._connected_at = 0.0  # monotonic
        self._is_stable = False
        self._link_text = ""
        self._watched_s: float | None = None  # monotonic

    async def run(self) -> None:
        """Serve the sensor until the driver returns. Faults of the driver are reported and retried."""
        timing = self._timing
        backoff = Backoff(timing.initial_reconnect_s, timing.max_reconnect_s)
        while True:
            self._begin()
            state, text = await self._serve_once()
            if text is None:
                self._report_link(
                    LinkState.LOST, message("health.sensor.no_more", "the driver has no more samples")
                )
                return
            self._report_link(state, text)
            if self._is_stable:
                backoff.reset()
            await backoff.wait()

    def _begin(self) -> None:
        self._connected_at = self._monotonic_s()
        self._active_at = None
        self._has_samples = False
        self._is_stable = False
        for monitor in self._monitors.values():
            monitor.restart()
        self._report_link(LinkState.SEARCHING, "")

    async def _serve_once(self) -> tuple[LinkState, str | None]:
        """Serve one connection; return its end, with no text when the driver has ended by itself."""
        serving = asyncio.ensure_future(self.driver.run(self._take))
        self._watched_s = None
        try:
            while not serving.done():
                await asyncio.wait([serving], timeout=self._timing.watch_s)
                if not serving.done() and (why := self._watch()) is not None:
                    return LinkState.LOST, why
            await serving
        except LinkLost as lost:
            return LinkState.LOST, text_of(lost) or message("health.sensor.lost", "the connection was lost")
        except asyncio.CancelledError:
            if serving.cancelled():
                return LinkState.LOST, "the driver was cancelled"
            raise
        except Exception as error:
            log.exception("sensor driver failed", extra={"source": self.driver.source})
            text = message(
                "health.sensor.driver_failed",
                "the driver failed: {error}",
                error=f"{type(error).__name__}: {error}"[:MAX_TEXT],
            )
            return LinkState.FAULT, text
        else:
            return LinkState.LOST, None
        finally:
            await _cancelled(serving)

    def _watch(self) -> str | None:
        """Look for silence and for a clock of ours that was set; return why the connection must be closed."""
        self._check_our_clock()
        self._check_our_pace()
        at_s = self._wall_s()
        for monitor in self._monitors.values():
            if (report := monitor.silence(at_s)) is not None:
                self._sink(report)
        limit_s = self._timing.max_silence_s
        limit_s = self.driver.max_silence_s if limit_s is None else limit_s
        if self._active_at is None or self._monotonic_s() - self._active_at < limit_s:
            return None
        return message(
            "health.sensor.link_silent", "connected, but silent for {seconds} s", seconds=round(limit_s, 2)
        )

    def _check_our_pace(self) -> None:
        """Notice that this machine was busy: what did not arrive meanwhile waits, and is late."""
        now_s = self._monotonic_s()
        before_s, self._watched_s = self._watched_s, now_s
        if before_s is None:
            return
        late_s = now_s - before_s - self._timing.watch_s
        if late_s <= MAX_LATE_S:
            return
        for monitor in self._monitors.values():
            monitor.delayed(self._wall_s(), late_s)
        if self._active_at is not None:
            self._active_at = min(self._active_at + late_s, now_s)

    def _check_our_clock(self) -> None:
        ahead_s = self._wall_s() - self._monotonic_s()
        step_s, self._wall_ahead_s = ahead_s - self._wall_ahead_s, ahead_s
        if abs(step_s) <= MAX_WALL_STEP_S:
            return
        self._monitors = {info: self._monitor(info) for info in self._monitors}
        text = message(
            "health.sensor.our_clock",
            "the clock of this machine was set by {seconds} s",
            seconds=round(step_s, 1),
        )
        self._sink(
            SensorReport(
                self.driver.source,
                self._wall_s(),
                fault=SensorFault.CLOCK_JUMP,
                text=text,
                details={"jump_s": step_s},
            )
        )

    def _monitor(self, info: SignalInfo) -> SignalMonitor:
        driver = self.driver
        return SignalMonitor(
            driver.source,
            info,
            driver.max_latency_s,
            driver.silence_limits_s.get(info.kind),
            stamps_oldest=driver.stamps_oldest,
        )

    def _take(self, item: Samples | SensorReport) -> None:
        self._check_our_clock()
        if isinstance(item, SensorReport):
            self._take_report(item)
            return
        monitor = self._monitors.get(item.info)
        if monitor is None:
            raise ValueError(
                f"the driver of {self.driver.source} sent {item.info.kind}, which its `signals` does not list"
            )
        now = self._monotonic_s()
        if not self._has_samples:
            self._has_samples = True
            self._first_samples()
        elif now - self._connected_at >= MIN_STABLE_S:
            self._is_stable = True
        self._active_at = now
        checked = monitor.take(replace(item, source=self.driver.source), self._wall_s())
        for report in checked.reports:
            self._sink(report)
        if checked.samples is not None:
            self._sink(checked.samples)
            if checked.samples.info.kind in EYE_STREAMS and checked.samples.quality > 0:
                self._nothing_happened(checked.samples.end_s)

    def _nothing_happened(self, until_s: float) -> None:
        """Pass on that the eyes, which the tracker sees, have done nothing since their last events."""
        for info, monitor in self._monitors.items():
            if info.kind in EYE_EVENTS:
                empty = monitor.nothing_happened(until_s, self._wall_s())
                if empty is not None:
                    self._sink(empty)

    def _first_samples(self) -> None:
        self.connections += 1
        self._report_link(LinkState.CONNECTED, "")
        if self.connections > 1:
            report = SensorReport(self.driver.source, self._wall_s(), fault=SensorFault.RECONNECTED)
            self._sink(report)

    def _take_report(self, report: SensorReport) -> None:
        battery = report.battery
        if battery is not None and 0.0 <= battery <= 1.0:
            self.battery = battery
        elif battery is not None:
            report = replace(report, battery=None)
        if report.has_contact is not None:
            self.has_contact = report.has_contact
        if report.link is not None:
            self.link = report.link
            self._link_text = report.text
            if report.link is LinkState.CONNECTED and self._active_at is None:
                self._active_at = self._monotonic_s()
        self._sink(replace(report, source=self.driver.source, text=_short(report.text)))

    def _report_link(self, link: LinkState, text: str) -> None:
        if (link, text) == (self.link, self._link_text):
            return
        self._take_report(SensorReport(self.driver.source, self._wall_s(), link=link, text=text))


def _short(text: str) -> str:
    return text if isinstance(text, Message) else text[:MAX_TEXT]


async def _cancelled(task: asyncio.Task[None]) -> None:
    """Cancel `task` and wait for it; what it raises meanwhile does not matter any more."""
    task.cancel()
    with suppress(asyncio.CancelledError, Exception):
        await task
