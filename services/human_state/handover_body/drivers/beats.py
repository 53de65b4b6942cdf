"""What several drivers need to make of beats: their times, and whether a strap is still worn. Pure."""

from typing import Final

MAX_DRIFT_S: Final = 1.5
"""Beats further from the arrival than this follow it again."""
REMOVED_S: Final = 5.0
"""A strap that has sent intervals between beats, and sends none for so long, is not worn."""


class BeatClock:
    """Times of beats whose intervals arrive in packets: each follows the one before by its interval.

    Notifications jitter by up to a second, intervals are exact to a millisecond. So the times are summed up,
    and follow the arrival only when they have drifted from it.
    """

    def __init__(self) -> None:
        self._last_s: float | None = None

    def times(self, intervals_s: list[float], arrival_s: float) -> list[float]:
        """Return the time of the beat that ends each interval, none later than `arrival_s`."""
        if not intervals_s:
            return []
        total_s = sum(intervals_s)
        last_s = self._last_s
        end_s = arrival_s if last_s is None else last_s + total_s
        if end_s > arrival_s or end_s < arrival_s - MAX_DRIFT_S:
            end_s = arrival_s
        times, at_s = [], end_s - total_s
        for interval_s in intervals_s:
            at_s += interval_s
            times.append(at_s)
        self._last_s = end_s
        return times


class ContactWatch:
    """Whether a chest strap is worn, from its contact bit or from beats that cease."""

    def __init__(self) -> None:
        self._last_beat_s: float | None = None

    def update(self, *, reported: bool | None, has_beats: bool, at_s: float) -> bool | None:
        """Return whether the strap has contact; None if nothing says so."""
        if has_beats:
            self._last_beat_s = at_s
        if self._last_beat_s is not None and at_s - self._last_beat_s > REMOVED_S:
            return False
        return reported if reported is not None or self._last_beat_s is None else True
