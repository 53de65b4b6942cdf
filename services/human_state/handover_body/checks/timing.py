"""The clock of a device, mapped to ours.

A packet that was sampled until `device_s` arrives at `arrival_s`. The difference of the two is the offset of
the clocks plus the delay of the packet, which is never negative. So the smallest difference of the last half
minute is the best estimate (Cristian, "Probabilistic clock synchronization", Distributed Computing 3, 1989,
for one way): it is too large by the delay of the fastest packet, and by what the clocks drift in that time.

The stated uncertainty holds if at least one packet of the window took at most `max_latency_s`, and the clock
of the device runs within `MAX_DRIFT` of its rate.
"""

from collections import deque
from typing import Final

WINDOW_S: Final = 30.0
MAX_DRIFT: Final = 200e-6
"""Crystals of wearables run within 100 ppm, and so does ours."""
_BUCKET_S: Final = 2.0
MIN_BUCKETS: Final = 5


class ClockMap:
    """Maps times of one device. Memory: three numbers per 2 s of the window."""

    def __init__(self, max_latency_s: float) -> None:
        self._max_latency_s = max_latency_s
        self._buckets: deque[tuple[float, float, float]] = deque()
        """Arrival at its start, smallest and largest difference."""

    def reset(self) -> None:
        """Forget everything: the device or its clock is another one."""
        self._buckets.clear()

    @property
    def offset_s(self) -> float | None:
        """Return what to add to a time of the device; None before the first packet."""
        return min((smallest for _, smallest, _ in self._buckets), default=None)

    @property
    def uncertainty_s(self) -> float:
        """Return how far a mapped time may be off."""
        if not self._buckets:
            return self._max_latency_s
        age_s = self._buckets[-1][0] + _BUCKET_S - self._buckets[0][0]
        return self._max_latency_s + MAX_DRIFT * age_s

    @property
    def jitter_s(self) -> float | None:
        """Return by how much packets differed in their delay; None in the first `MIN_BUCKETS` times 2 s."""
        if len(self._buckets) < MIN_BUCKETS:
            return None
        return max(largest for _, _, largest in self._buckets) - min(least for _, least, _ in self._buckets)

    def observe(self, device_s: float, arrival_s: float) -> float:
        """Take the time of a packet's newest sample and of its arrival; return the offset."""
        difference_s = arrival_s - device_s
        buckets = self._buckets
        if buckets and 0.0 <= arrival_s - buckets[-1][0] < _BUCKET_S:
            began_s, smallest, largest = buckets[-1]
            buckets[-1] = (began_s, min(smallest, difference_s), max(largest, difference_s))
        else:
            buckets.append((arrival_s, difference_s, difference_s))
        while len(buckets) > 1 and not 0.0 <= arrival_s - buckets[0][0] <= WINDOW_S:
            buckets.popleft()
        return min(smallest for _, smallest, _ in buckets)
