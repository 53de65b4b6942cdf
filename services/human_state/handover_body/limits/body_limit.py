"""The speed limit of one person: a state machine whose limit only falls, unless a calm body allows more.

- A fresh heart rate lowers the limit at once.
- The limit rises only while the heart rate is fresh, no sensor has a fault, and the limit computed at 5 bpm
  more has exceeded the present one for 10 s without a break; then by 5 % a second, up to the limit at 5 bpm
  more.
- A stale heart rate lets the limit fall to 25 %, and it is 0 at the timeout (10 s, radar 20 s).
- Before the first heart rate the limit is 25 %, and 0 from 10 s on; it then rises as for a calm body.
- Afterwards a limit of 0 is a stop. It is latched: a person aboard or in charge resets it, and only while the
  heart rate is fresh and allows more than 0.

Invariants, for any order of heart rates, faults and pauses: 0 <= fraction <= 1; a stop ends only by a reset;
between two steps the fraction rises by at most 5 % a second, and never while a fault lasts or a value is
overdue; from the timeout on it is 0.

Example: at 121 bpm a curve from 90 to 125 bpm with a least of 0.2 gives 0.29, at once. At 100 bpm it would
give 0.77, at 105 bpm 0.66. After 10 s at 100 bpm the limit rises by 5 % a second and ends at 0.66.

The wheelchair, the treadmill and the arm use the same machine. Advisory only; no safety function.
"""

from dataclasses import dataclass, replace
from typing import Final

from handover_body.fusion.plausibility import stale_after_s
from handover_body.limits.curve import LimitCurve

STALE_FRACTION: Final = 0.25
TIMEOUT_S: Final = 10.0
RADAR_TIMEOUT_S: Final = 20.0
MIN_RAMP_S: Final = 3.5
"""The ramp begins this long before the timeout at the latest, whatever period a sensor says."""
MARGIN_BPM: Final = 5.0
HOLD_S: Final = 10.0
RAISE_PER_S: Final = 0.05
OVERDUE_PERIODS: Final = 1.5
RESTART_FRACTION: Final = 0.05
MAX_STEP_S: Final = 1.0
"""A longer pause between two steps raises the limit no more than this."""


class RefusedReset(ValueError):
    """A reset that is not possible now; the text says why."""


@dataclass(frozen=True, slots=True)
class HeartRate:
    """The newest heart rate that may feed a limit, at `at_s` on the clock of the steps."""

    bpm: float
    at_s: float
    period_s: float = 1.0
    timeout_s: float = TIMEOUT_S

    @property
    def stale_s(self) -> float:
        """Return the age from which on the limit falls."""
        return min(stale_after_s(self.period_s), self.timeout_s - MIN_RAMP_S)


@dataclass(frozen=True, slots=True)
class BodyLimit:
    """The limit of one person at the time of the last step."""

    curve: LimitCurve
    since_s: float
    """When the person was bound; the age of a heart rate that never came."""
    at_s: float
    fraction: float = STALE_FRACTION
    is_stopped: bool = False
    newest: HeartRate | None = None
    exceeds_since_s: float | None = None
    ramp_from: float | None = None
    """The fraction at which the heart rate became stale."""

    def step(self, heart_rate: HeartRate | None, now_s: float, *, has_fault: bool = False) -> "BodyLimit":
        """Return the limit at `now_s` (s, monotonic); a time before the last step counts as that one.

        `heart_rate` is the newest valid one, None without; an older one than known is ignored.
        """
        now_s = max(now_s, self.at_s)
        newest = self._newest(heart_rate, now_s)
        made = replace(self, newest=newest, at_s=now_s)
        age_s = now_s - (self.since_s if newest is None else newest.at_s)
        timeout_s = TIMEOUT_S if newest is None else newest.timeout_s
        stale_s = 0.0 if newest is None else newest.stale_s
        if newest is None and age_s >= timeout_s and not self.is_stopped:
            return replace(made, fraction=0.0, exceeds_since_s=None, ramp_from=None)
        if self.is_stopped or age_s >= timeout_s:
            return replace(made, fraction=0.0, is_stopped=True, exceeds_since_s=None, ramp_from=None)
        if newest is None or age_s > stale_s:
            return made._falling(age_s, stale_s, timeout_s)
        target = self.curve.fraction(newest.bpm)
        if target <= 0.0:
            return replace(made, fraction=0.0, is_stopped=True, exceeds_since_s=None, ramp_from=None)
        if target < self.fraction:
            return replace(made, fraction=target, exceeds_since_s=None, ramp_from=None)
        return made._rising(newest, now_s - self.at_s, is_calm=heart_rate is not None and not has_fault)

    def _newest(self, heart_rate: HeartRate | None, now_s: float) -> HeartRate | None:
        if heart_rate is None:
            return self.newest
        heart_rate = replace(heart_rate, at_s=min(heart_rate.at_s, now_s))
        return heart_rate if self.newest is None or heart_rate.at_s >= self.newest.at_s else self.newest

    def _falling(self, age_s: float, stale_s: float, timeout_s: float) -> "BodyLimit":
        """Return the limit while the heart rate is stale: at 25 % halfway to the timeout."""
        ramp_from = self.fraction if self.ramp_from is None else self.ramp_from
        share = min((age_s - stale_s) / ((timeout_s - stale_s) / 2), 1.0)
        on_ramp = ramp_from + share * (STALE_FRACTION - ramp_from)
        return replace(self, fraction=min(self.fraction, on_ramp), exceeds_since_s=None, ramp_from=ramp_from)

    def _rising(self, newest: HeartRate, passed_s: float, *, is_calm: bool) -> "BodyLimit":
        """Return the limit while a fresh heart rate allows more than the present one."""
        cautious = self.curve.fraction(newest.bpm + MARGIN_BPM)
        is_due = self.at_s - newest.at_s <= OVERDUE_PERIODS * max(newest.period_s, 0.0)
        if not is_calm or not is_due or cautious <= self.fraction:
            return replace(self, exceeds_since_s=None, ramp_from=None)
        if self.exceeds_since_s is None:
            return replace(self, exceeds_since_s=self.at_s, ramp_from=None)
        if self.at_s - self.exceeds_since_s <= HOLD_S:
            return replace(self, ramp_from=None)
        raised = self.fraction + RAISE_PER_S * min(passed_s, MAX_STEP_S)
        return replace(self, fraction=min(raised, cautious), ramp_from=None)

    def reset(self, now_s: float) -> "BodyLimit":
        """End a stop, by a person; the limit rises from 5 %. Raises `RefusedReset`."""
        if not self.is_stopped:
            return self
        newest = self.newest
        if newest is None or now_s - newest.at_s > newest.stale_s:
            raise RefusedReset("no sensor sends a valid heart rate; put the sensor on, then reset again")
        target = self.curve.fraction(newest.bpm)
        if target <= 0.0:
            raise RefusedReset(
                f"the heart rate is {newest.bpm:.0f} bpm, which still stops the robot; rest, then reset again"
            )
        return replace(
            self,
            fraction=min(RESTART_FRACTION, target),
            is_stopped=False,
            exceeds_since_s=None,
            ramp_from=None,
            at_s=max(now_s, self.at_s),
        )

    def reason(self, now_s: float) -> str:
        """Return why the limit is what it is, without a figure of the body: robots and the broker get it."""
        newest = self.newest
        if newest is None:
            return (
                "stopped; a person must reset it (no heart rate yet)"
                if self.is_stopped
                else "no heart rate yet"
            )
        age_s = now_s - newest.at_s
        if age_s > newest.stale_s:
            seen = f"no valid heart rate for {age_s:.0f} s"
        elif self.curve.fraction(newest.bpm) < 1.0:
            seen = "the heart rate is high"
        elif self.fraction < 1.0 and not self.is_stopped:
            seen = "the heart rate is normal, and the limit rises slowly"
        else:
            seen = "the heart rate is normal"
        return f"stopped; a person must reset it ({seen})" if self.is_stopped else seen
