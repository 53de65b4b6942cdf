"""SpeedLimits of people: received from sources, aged by the clock, and only ever lowering.

A source reports how fast the robot may move while a person is strained. Between reports the last one applies.
A silent source ages out: it is stale after three of its periods (3 s at least), its limit then falls to 25 %,
and at the end of its timeout the robot stops. A stop, by a report of 0 or by age, is latched until a person
resets it. A higher limit takes effect by 5 % a second.

Example: a source with a period of 1 s reports 0.8 and falls silent. The limit is 0.8 for 3 s, falls to 0.25
at 6.5 s and to 0 at 10 s. When it reports 0.8 again, the robot still waits for the reset.

A source that was received once is required until it is removed. One that is required and was never received
is stale from the start; its stop is not latched.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from handover.messages import message
from handover_datamodels.streams import DEFAULT_TIMEOUT_S, SpeedLimitReport

STALE_FRACTION = 0.25
RAISE_PER_S = 0.05
MAX_SOURCES = 32
MAX_LATE_S, MAX_AHEAD_S = 2.0, 1.0
"""How far the stamp of a report may be from the time of its arrival."""


class RefusedReport(ValueError):
    """A report that has no effect; the text says why."""


def require_new(stamp: float, before: float | None, wall_s: float) -> None:
    """Refuse a stamp that is not later than the one before, or far from `wall_s`. Raises `RefusedReport`."""
    if before is not None and stamp <= before:
        raise RefusedReport(f"the stamp must be later than {before:.3f}")
    if not -MAX_LATE_S <= stamp - wall_s <= MAX_AHEAD_S:
        raise RefusedReport(
            f"the stamp is {wall_s - stamp:.1f} s before the clock of the robot; at most "
            f"{MAX_LATE_S:.0f} s are permitted ({MAX_AHEAD_S:.0f} s after it); synchronize the clocks"
        )


@dataclass(frozen=True, slots=True)
class Allowed:
    """What a rule allows: a fraction of the speed, a speed of the tool, and why."""

    rule: str
    fraction: float = 1.0
    max_speed_mps: float = math.inf
    reason: str = ""
    needs_reset: bool = False

    def pace(self, peak_speed_mps: float) -> float:
        """Return the fraction for a motion whose tool reaches `peak_speed_mps` at full speed."""
        if self.max_speed_mps >= peak_speed_mps:
            return self.fraction
        return min(self.fraction, self.max_speed_mps / peak_speed_mps)


@dataclass(frozen=True, slots=True)
class _Source:
    """The last report of a source and when it arrived; None before any report.

    A higher limit rises from `raised_from` at the time `raised_s`.
    """

    since_s: float
    report: SpeedLimitReport | None = None
    raised_from: float = 1.0
    raised_s: float = 0.0
    is_latched: bool = False

    def fraction(self, now_s: float) -> float:
        if self.is_latched:
            return 0.0
        age_s = max(now_s - self.since_s, 0.0)
        report = self.report
        if report is None:
            return STALE_FRACTION if age_s < DEFAULT_TIMEOUT_S else 0.0
        rising_s = max(min(now_s, self.since_s + report.stale_s) - self.raised_s, 0.0)
        fresh = min(report.fraction, self.raised_from + RAISE_PER_S * rising_s)
        if age_s <= report.stale_s:
            return fresh
        if age_s >= report.timeout:
            return 0.0
        middle_s = (report.stale_s + report.timeout) / 2
        share = min((age_s - report.stale_s) / (middle_s - report.stale_s), 1.0)
        return min(fresh, fresh + share * (STALE_FRACTION - fresh))

    def is_stopped(self, now_s: float) -> bool:
        """Return whether the stop needs a reset."""
        if self.report is None:
            return False
        return self.is_latched or now_s - self.since_s >= self.report.timeout

    def is_stale(self, now_s: float) -> bool:
        return self.report is None or now_s - self.since_s > self.report.stale_s

    def allowed(self, name: str, now_s: float) -> Allowed:
        fraction, report = self.fraction(now_s), self.report
        if report is None:
            return Allowed(
                name, fraction, reason=message("limit.source_not_received", "required, and not received yet")
            )
        reason = report.reason
        if self.is_stale(now_s):
            silent_s = f"{now_s - self.since_s:.0f}"
            reason = message("limit.source_silent", "silent for {silent_s} s", silent_s=silent_s)
        needs_reset = self.is_stopped(now_s)
        if needs_reset:
            reason = message("limit.stopped", "stopped; a person must reset it ({reason})", reason=reason)
        return Allowed(name, fraction, report.max_speed or math.inf, reason, needs_reset)


class SpeedLimits:
    """The sources of one robot. Reports arrive in one thread; others may read.

    `required` are the names of the sources without which the robot does not move.
    """

    def __init__(self, required: Iterable[str], now_s: float) -> None:
        self._sources = {name: _Source(now_s) for name in required}

    @property
    def sources(self) -> tuple[str, ...]:
        """Return the names of the required sources."""
        return tuple(self._sources)

    def receive(self, report: SpeedLimitReport, now_s: float, wall_s: float) -> bool:
        """Take a report at a time, `wall_s` in s since 1970; return whether its source is new.

        Raises `RefusedReport` for a stamp that is not later than the one before, or far from `wall_s`, and
        for too many sources.
        """
        before = self._sources.get(report.source)
        if before is None and len(self._sources) >= MAX_SOURCES:
            raise RefusedReport(f"there are {MAX_SOURCES} sources; remove one before another reports")
        last = None if before is None else before.report
        require_new(report.stamp, None if last is None else last.stamp, wall_s)
        is_first = before is None or before.report is None
        present = report.fraction if before is None or is_first else before.fraction(now_s)
        is_latched = report.fraction == 0.0 or (before is not None and before.is_stopped(now_s))
        self._sources[report.source] = _Source(now_s, report, present, now_s, is_latched)
        return before is None

    def reports(self) -> tuple[SpeedLimitReport, ...]:
        """Return the last report of each source."""
        return tuple(source.report for source in tuple(self._sources.values()) if source.report is not None)

    def remove(self, source: str) -> bool:
        """Stop requiring a source; return whether it was required."""
        return self._sources.pop(source, None) is not None

    def reset(self, now_s: float) -> list[str]:
        """Release latched stops of sources that report again; return the sources that still stop the robot.

        After a reset the limit rises from 0 by 5 % a second.
        """
        for name, source in tuple(self._sources.items()):
            is_ready = source.report is not None and source.report.fraction > 0
            if source.is_latched and is_ready and not source.is_stale(now_s):
                self._sources[name] = replace(source, is_latched=False, raised_from=0.0, raised_s=now_s)
        return [name for name, source in self._sources.items() if source.allowed(name, now_s).needs_reset]

    def allowed(self, now_s: float) -> tuple[Allowed, ...]:
        """Return what each source allows."""
        return tuple(source.allowed(name, now_s) for name, source in tuple(self._sources.items()))
