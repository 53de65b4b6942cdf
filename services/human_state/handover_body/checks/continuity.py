"""Where a packet of a regular signal continues the one before. Pure."""

from dataclasses import dataclass
from typing import Final

from handover_body.model.signals import ClockKind, SignalInfo

MAX_RATE_ERROR: Final = 0.02
_RATE_SPAN_S: Final = 1.0
_MAX_RATE_SPAN_S: Final = 10.0
_MAX_ARRIVAL_SPAN_S: Final = 60.0
"""Arrivals jitter by a packet: a rate that is 4 % wrong shows in this time."""


@dataclass(frozen=True, slots=True)
class Found:
    """What the stamp of a packet says."""

    gap_s: float = 0.0
    jump_s: float = 0.0
    rate_hz: float | None = None
    """The measured rate, if it is not the stated one."""
    is_continued: bool = False
    is_repeated: bool = False


class Continuity:
    """Where a packet of a regular signal continues the one before: gaps, jumps, and a rate that lies.

    The device says when its samples were taken (or the arrival does). If a packet starts later than the one
    before ended, either samples are missing, and then as much of our time has passed, or the clock jumped.
    """

    def __init__(self, info: SignalInfo) -> None:
        self._rate_hz = info.rate_hz or 1.0
        self._last: tuple[float, int, float] | None = None  # start, count, arrival
        self._ratio: float | None = None
        self._counted = 0
        self._counted_from_s = 0.0
        self._measured_hz: float | None = None

    def take(
        self, start_s: float, count: int, arrival_s: float, clock: ClockKind, late_s: float = 0.0
    ) -> Found:
        """Take the stamp of the next packet, its number of samples and its arrival.

        `late_s` is how long this machine took nothing just before.
        """
        last, self._last = self._last, (start_s, count, arrival_s)
        if last is None:
            self._restart(start_s, count)
            return Found()
        last_start_s, last_count, last_arrival_s = last
        span_s = last_count / self._rate_hz
        gap_s = start_s - last_start_s - span_s
        if clock is ClockKind.ARRIVAL:
            return self._arrived(start_s, count, span_s, gap_s, late_s)
        if (start_s, count) == (last_start_s, last_count):
            return Found(is_repeated=True)
        if abs(gap_s) <= max(1.5 / self._rate_hz, 0.05 * span_s):
            self._ratio = None
            return self._continued(start_s, count, slack_s=2 / self._rate_hz)
        self._restart(start_s, count)
        ratio, before = (start_s - last_start_s) / span_s, self._ratio
        self._ratio = ratio
        if 0.4 < ratio < 2.5 and before is not None and abs(ratio / before - 1) < 0.02:
            self._measured_hz = self._rate_hz / ratio
            return Found(max(gap_s, 0.0), min(gap_s, 0.0), self._measured_hz)
        passed_s = arrival_s - last_arrival_s
        is_lost = gap_s > 0 and (clock is ClockKind.RECORDING or passed_s + 1.0 > gap_s)
        return Found(gap_s=gap_s) if is_lost else Found(jump_s=gap_s)

    def _arrived(self, start_s: float, count: int, span_s: float, gap_s: float, late_s: float) -> Found:
        """Arrivals jitter: only what exceeds a slow packet, or a pause of this machine, is a gap."""
        if gap_s > (max(0.25, 3 * span_s) if span_s < 0.5 else 1.5 * span_s) + late_s:
            self._restart(start_s, count)
            return Found(gap_s=gap_s)
        slack_s = 0.3 + span_s + late_s
        return self._continued(start_s, count, slack_s, longest_s=_MAX_ARRIVAL_SPAN_S)

    def _restart(self, start_s: float, count: int) -> None:
        self._counted = count
        self._counted_from_s = start_s

    def _continued(
        self, start_s: float, count: int, slack_s: float, longest_s: float = _MAX_RATE_SPAN_S
    ) -> Found:
        """Compare the samples counted since some packet with the time between them."""
        span_s = start_s - self._counted_from_s
        stated_s = self._counted / self._rate_hz
        if span_s > 0 and stated_s >= _RATE_SPAN_S:
            is_wrong = abs(span_s - stated_s) > MAX_RATE_ERROR * stated_s + slack_s
            if is_wrong:
                self._measured_hz = self._counted / span_s
            if is_wrong or stated_s >= longest_s:
                if not is_wrong:
                    self._measured_hz = None
                self._restart(start_s, 0)
        self._counted += count
        return Found(rate_hz=self._measured_hz, is_continued=True)
