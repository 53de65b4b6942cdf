"""Rates: a token bucket, with the time as an argument."""

from dataclasses import dataclass
from typing import Final

BURST_S: Final = 5.0
"""A device may send at once what its rate allows in this time."""
FAULTS_PER_S, MAX_FAULTS = 1.0, 50.0


@dataclass(slots=True)
class TokenBucket:
    """Allows `rate` units a second on average and `burst` at once; a debt has to be waited for.

    `spend` always succeeds, since the bytes have arrived already; it returns how long the sender must wait
    before it may send more. So within any time T at most `burst + rate T` units plus one message pass.
    """

    rate: float
    burst: float
    level: float
    at_s: float

    @classmethod
    def full(cls, rate: float, burst: float, now_s: float) -> "TokenBucket":
        """Return a bucket that has not been used."""
        return cls(rate, burst, burst, now_s)

    def spend(self, units: float, now_s: float) -> float:
        """Take `units`; return the seconds until the bucket has no debt, 0 if it has none."""
        elapsed_s = max(now_s - self.at_s, 0.0)
        self.level = min(self.level + elapsed_s * self.rate, self.burst) - units
        self.at_s = max(now_s, self.at_s)
        return max(-self.level / self.rate, 0.0)

    def take(self, units: float, now_s: float) -> bool:
        """Take `units` if that makes no debt; return whether they were taken."""
        if self.spend(units, now_s) == 0:
            return True
        self.level += units
        return False


@dataclass(slots=True)
class DeviceRates:
    """The rates of one device: of its messages, and of those that are invalid."""

    messages: TokenBucket
    faults: TokenBucket

    @classmethod
    def of(cls, messages_per_s: float, now_s: float) -> "DeviceRates":
        """Return the rates of a device that has sent nothing."""
        return cls(
            TokenBucket.full(messages_per_s, messages_per_s * BURST_S, now_s),
            TokenBucket.full(FAULTS_PER_S, MAX_FAULTS, now_s),
        )
