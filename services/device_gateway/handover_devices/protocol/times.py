"""Times of devices: a message may be late, since a device buffers while it is away, but not from the future.

A device whose clock is wrong would write a series that never ends, or overwrite the latest value for ever. So
`t` is accepted from `max_age_s` ago to `max_ahead_s` from now, which allows clocks to differ a little.
"""

from dataclasses import dataclass

from handover_devices.protocol.messages import BadMessage

_UNITS = {1_000: "milliseconds", 1_000_000: "microseconds", 1_000_000_000: "nanoseconds"}


@dataclass(frozen=True, slots=True)
class TimeRule:
    """Which times of devices are accepted."""

    max_age_s: float
    max_ahead_s: float

    def time_of(self, t: float | None, now_s: float, seq: int | None = None) -> float:
        """Return the time of a message, `now_s` if it has none; raise `BadMessage` if it is implausible."""
        if t is None:
            return now_s
        if t > now_s + self.max_ahead_s:
            unit = self._unit_of(t, now_s)
            remedy = f"divide it by {unit}" if unit else "set the clock of the device (NTP), or leave t out"
            raise BadMessage(
                "future",
                f"t is {t - now_s:.0f} s ahead of the gateway, and at most {self.max_ahead_s:g} s are "
                f"allowed; {remedy}",
                seq,
            )
        if t < now_s - self.max_age_s:
            raise BadMessage(
                "tooOld",
                f"t is {now_s - t:.0f} s ago, and at most {self.max_age_s:g} s are allowed; set the clock of "
                "the device (NTP), or leave t out",
                seq,
            )
        return t

    def _unit_of(self, t: float, now_s: float) -> str | None:
        """Return the factor and name of the smaller unit in which `t` is a plausible time; None if none."""
        for factor, name in _UNITS.items():
            if now_s - self.max_age_s <= t / factor <= now_s + self.max_ahead_s:
                return f"{factor}: t is in seconds, and this looks like {name}"
        return None
