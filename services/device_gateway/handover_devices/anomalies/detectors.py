"""Detectors: whether a value is abnormal, with the time as an argument and without I/O.

Each detector judges one series. Its state is bounded: at most `MAX_SAMPLES` numbers, whatever the rate of
the values. A detector that learns (`ZScore`) can be stored and loaded. An abnormal value changes what it has
learned only as far as its threshold: an outlier is not learned at once, but a new level is in time.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Protocol

from handover_devices.anomalies.rules import (
    LimitCheck,
    RateCheck,
    Rule,
    SeasonalCheck,
    SilenceCheck,
    ZScoreCheck,
)

MAX_SAMPLES: Final = 64


class Judgement(Enum):
    """What a detector says about a value; `BETWEEN` is neither abnormal nor normal again."""

    ABNORMAL = "abnormal"
    BETWEEN = "between"
    NORMAL = "normal"


@dataclass(frozen=True, slots=True)
class Verdict:
    """A judgement, with the number that was compared and its limit."""

    judgement: Judgement
    measured: float
    limit: float


NOT_JUDGED: Final = Verdict(Judgement.BETWEEN, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Baseline:
    """The usual values of each interval of a period: mean, standard deviation and number of periods."""

    period_s: float
    interval_s: float
    usual: dict[int, tuple[float, float, int]]

    def at(self, t: float) -> tuple[float, float, int] | None:
        """Return what is usual at a time."""
        return self.usual.get(int(t % self.period_s // self.interval_s))


class Detector(Protocol):
    """Judges the values of one series, in the order of their time."""

    def judge(self, t: float, value: float) -> Verdict:
        """Judge a value."""
        ...

    def state(self) -> dict[str, Any] | None:
        """Return what was learned, as JSON; None if nothing has to be kept."""
        ...


def _by_limit(measured: float, limit: float, hysteresis: float) -> Verdict:
    if measured > limit:
        return Verdict(Judgement.ABNORMAL, measured, limit)
    judgement = Judgement.NORMAL if measured <= limit * (1 - hysteresis) else Judgement.BETWEEN
    return Verdict(judgement, measured, limit)


@dataclass(slots=True)
class Limits:
    """Detector of `LimitCheck`."""

    check: LimitCheck

    def judge(self, t: float, value: float) -> Verdict:  # noqa: ARG002
        """Judge a value."""
        check = self.check
        if check.maximum is not None and value > check.maximum:
            return Verdict(Judgement.ABNORMAL, value, check.maximum)
        if check.minimum is not None and value < check.minimum:
            return Verdict(Judgement.ABNORMAL, value, check.minimum)
        is_inside = (check.maximum is None or value <= check.maximum - check.hysteresis) and (
            check.minimum is None or value >= check.minimum + check.hysteresis
        )
        limit = check.maximum if check.maximum is not None else check.minimum
        assert limit is not None  # noqa: S101 - one of them is given
        return Verdict(Judgement.NORMAL if is_inside else Judgement.BETWEEN, value, limit)

    def state(self) -> None:
        """Nothing is learned."""


@dataclass(slots=True)
class Rate:
    """Detector of `RateCheck`: compares a value with the oldest within the time of the rule."""

    check: RateCheck
    samples: deque[tuple[float, float]] = field(default_factory=deque)

    def judge(self, t: float, value: float) -> Verdict:
        """Judge a value."""
        samples, over_s = self.samples, self.check.over_s
        while len(samples) > 1 and t - samples[1][0] >= over_s:
            samples.popleft()
        verdict = NOT_JUDGED
        if samples and t - samples[0][0] >= over_s / 2:  # a shorter time would show the noise
            rate = abs(value - samples[0][1]) / (t - samples[0][0])
            verdict = _by_limit(rate, self.check.max_per_s, self.check.hysteresis)
        if not samples or t - samples[-1][0] >= over_s / (MAX_SAMPLES - 2):
            samples.append((t, value))
        return verdict

    def state(self) -> None:
        """Nothing is learned."""


@dataclass(slots=True)
class ZScore:
    """Detector of `ZScoreCheck`; `n` counts the values until the window is full."""

    check: ZScoreCheck
    n: int = 0
    mean: float = 0.0
    variance: float = 0.0

    def judge(self, t: float, value: float) -> Verdict:  # noqa: ARG002
        """Judge a value, then learn it."""
        check, verdict = self.check, NOT_JUDGED
        deviation = max(math.sqrt(self.variance), check.minimum_deviation)
        learned = value
        if self.n >= check.minimum_values:
            distance = abs(value - self.mean)
            # A series that never changed has no deviation: any other value is infinitely far away.
            z = distance / deviation if deviation > 0 else (math.inf if distance > 0 else 0.0)
            verdict = _by_limit(min(z, 1e9), check.threshold, check.hysteresis)
            reach = check.threshold * (deviation or distance)
            learned = min(max(value, self.mean - reach), self.mean + reach)
        self.n = min(self.n + 1, check.window)
        weight = 1 / self.n if self.n < check.window else 2 / (check.window + 1)
        difference = learned - self.mean
        self.mean += weight * difference
        self.variance = (1 - weight) * (self.variance + weight * difference * difference)
        return verdict

    def state(self) -> dict[str, Any]:
        """Return mean and variance."""
        return {"n": self.n, "mean": self.mean, "variance": self.variance}


@dataclass(slots=True)
class Seasonal:
    """Detector of `SeasonalCheck`; `baseline` is computed from the history and replaced now and then."""

    check: SeasonalCheck
    baseline: Baseline | None = None

    def judge(self, t: float, value: float) -> Verdict:
        """Judge a value."""
        check = self.check
        usual = self.baseline.at(t) if self.baseline is not None else None
        if usual is None or usual[2] < check.minimum_periods:
            return NOT_JUDGED
        mean, deviation, _ = usual
        deviation = max(deviation, check.minimum_deviation)
        distance = abs(value - mean)
        z = distance / deviation if deviation > 0 else (math.inf if distance > 0 else 0.0)
        return _by_limit(min(z, 1e9), check.threshold, check.hysteresis)

    def state(self) -> None:
        """The baseline is computed again."""


@dataclass(slots=True)
class Silence:
    """Detector of `SilenceCheck`; `judge_silence` judges the time without a value."""

    check: SilenceCheck

    def judge(self, t: float, value: float) -> Verdict:  # noqa: ARG002
        """A value ends the silence."""
        return Verdict(Judgement.NORMAL, 0.0, self.check.after_s)

    def judge_silence(self, silent_s: float) -> Verdict:
        """Judge the time since the last value."""
        is_silent = silent_s > self.check.after_s
        return Verdict(Judgement.ABNORMAL if is_silent else Judgement.BETWEEN, silent_s, self.check.after_s)

    def state(self) -> None:
        """Nothing is learned."""


def detector_of(rule: Rule, state: dict[str, Any] | None = None) -> Detector:
    """Return the detector of a rule, with what it had learned before."""
    check = rule.check
    if isinstance(check, LimitCheck):
        return Limits(check)
    if isinstance(check, RateCheck):
        return Rate(check)
    if isinstance(check, SilenceCheck):
        return Silence(check)
    if isinstance(check, SeasonalCheck):
        return Seasonal(check)
    state_before = state or {}
    return ZScore(
        check,
        int(state_before.get("n", 0)),
        float(state_before.get("mean", 0.0)),
        float(state_before.get("variance", 0.0)),
    )


@dataclass(slots=True)
class Alarm:
    """Hysteresis in time: on after abnormal for `for_s`, off after normal for `clear_after_s`.

    Worked example with `for_s` 10 and `clear_after_s` 5: abnormal at 0, 4 and 10 s: on at 10 s. Normal at
    12 s, between at 14 s, normal at 17 s: off at 17 s. Abnormal at 14 s instead: on, and the 5 s begin again.
    """

    for_s: float
    clear_after_s: float
    is_on: bool = False
    since: float | None = None
    """When the value became abnormal (while off) or normal (while on)."""

    def update(self, t: float, judgement: Judgement) -> bool:
        """Process a judgement; return whether the alarm went on or off."""
        if judgement is Judgement.BETWEEN:
            if not self.is_on:
                self.since = None
            return False
        if judgement is not (Judgement.NORMAL if self.is_on else Judgement.ABNORMAL):
            self.since = None
            return False
        if self.since is None:
            self.since = t
        if t - self.since < (self.clear_after_s if self.is_on else self.for_s):
            return False
        self.is_on, self.since = not self.is_on, None
        return True
