"""A simulated hand in a glove: the values of five flex sensors with movement, coupling of fingers and drift.

Levels and noise are those of real recordings: three people, the ten Chinese number signs, about a
thousand frames of each at 50 Hz (J. Cheng, Z. Sun, J. Wang, J. Zhang, "Chinese Number Gesture Recognition
Glove Based on Flex Sensors"). The derivation of each number is documented beside it.
"""

import math
import random
from collections.abc import Iterable
from dataclasses import dataclass

from glove_sdk_bridge.frames import Five

Posture = tuple[float, float, float, float, float]
"""The intended position of each finger, thumb first: 0 as in a fist, 1 as in an open hand."""

FIST: Posture = (0.0, 0.0, 0.0, 0.0, 0.0)
OPEN_HAND: Posture = (1.0, 1.0, 1.0, 1.0, 1.0)
AT_REST: Posture = (0.0, 0.18, 0.16, 0.16, 0.18)
"""A relaxed hand: loosely closed, the thumb on the fingers. It is far enough from straight that no drift
makes it a
gesture."""

HALF_BENT = 0.53
RATE_HZ = 50.0


@dataclass(frozen=True, slots=True)
class FingerSensor:
    """One finger's sensor, in raw units of its converter.

    `bent` and `straight`: the median in the fist (sign 0) and the open hand (sign 5), averaged over the
    three people. `noise`: the standard deviation of the differences of successive values, over √2; the
    median over people and signs (0 to 6, and 8). `wander`: the standard deviation within a sign once its
    linear trend is taken away, median as before. `drift`: the change that the linear trend makes over the
    24 s that a sign lasts on average, median as before. `sag`: the share of the span that a stretched
    finger falls short of the open hand when the finger beside it is bent, median over people and signs.
    """

    bent: float
    straight: float
    noise: float
    wander: float
    drift: float
    sag: float


SENSORS = (
    FingerSensor(bent=305, straight=405, noise=1.26, wander=8.4, drift=11.7, sag=0.16),
    FingerSensor(bent=485, straight=714, noise=0.77, wander=4.4, drift=9.0, sag=0.02),
    FingerSensor(bent=510, straight=722, noise=0.83, wander=3.7, drift=7.8, sag=0.04),
    FingerSensor(bent=515, straight=705, noise=0.85, wander=4.9, drift=10.4, sag=0.04),
    FingerSensor(bent=470, straight=677, noise=0.91, wander=5.8, drift=11.0, sag=0.10),
)
"""Thumb first."""

DRAG = 0.14
"""The share of its span by which a straight finger lifts the bent one beside it.

The median of how far bent fingers stand above their level in the fist, over people, fingers and signs.
"""

FAR_DRAG = 0.07
"""The same for the finger after the next; in the recordings a second straight finger adds about half."""

WANDER_S = 0.36
"""Time constant of the wander; its autocorrelation falls to 1/e after 0.51 to 1.07 s (median 0.79), which
is 2.15 time constants of the two low-pass filters in a row that make it."""

DRIFT_S = 30.0
"""Time constant of the drift: within one of the recordings it looks like a trend."""

MAX_DRIFT_SIGMAS = 2.0
"""Drift is bounded by so many of its standard deviations: in the recordings every level returns."""


class SimulatedHand:
    """A hand whose sensors are read `rate_hz` times a second; `seed` makes the values reproducible."""

    def __init__(
        self,
        seed: int | None = None,
        *,
        rate_hz: float = RATE_HZ,
        sensors: tuple[FingerSensor, ...] = SENSORS,
        posture: Posture = AT_REST,
    ) -> None:
        self.rate_hz = rate_hz
        self._sensors = sensors
        self._chance = random.Random(seed)  # noqa: S311 - a simulation, no secret
        self._from = self._to = posture
        self._moved_s = self._duration_s = 0.0
        self._unsteadiness = [_Unsteadiness(sensor, rate_hz, self._chance) for sensor in sensors]

    @property
    def posture(self) -> Posture:
        """The present position of the fingers during the movement."""
        done = minimum_jerk(self._moved_s / self._duration_s) if self._duration_s > 0 else 1.0
        return _five(start + done * (end - start) for start, end in zip(self._from, self._to, strict=True))

    def move(self, to: Posture, duration_s: float) -> None:
        """Start a movement of the fingers to `to`, which takes `duration_s`."""
        self._from, self._to = self.posture, to
        self._moved_s, self._duration_s = 0.0, duration_s

    def read(self) -> Five:
        """Return the raw values one reading later, thumb first."""
        self._moved_s = min(self._moved_s + 1 / self.rate_hz, self._duration_s)
        shares = dragged(self.posture, self._sensors)
        thumb, index, middle, ring, little = (
            round(level(sensor, share) + unsteadiness.next())
            for sensor, share, unsteadiness in zip(self._sensors, shares, self._unsteadiness, strict=True)
        )
        return thumb, index, middle, ring, little


def minimum_jerk(done: float) -> float:
    """Return the progress of a movement (0 to 1) after the share `done` of its time.

    T. Flash, N. Hogan: The coordination of arm movements, J. Neurosci. 5 (1985).
    """
    done = min(max(done, 0.0), 1.0)
    return done**3 * (10 - 15 * done + 6 * done**2)


def dragged(posture: Posture, sensors: tuple[FingerSensor, ...] = SENSORS) -> Posture:
    """Return the actual finger positions of `posture`, with the coupling of neighbours."""
    return _five(
        share
        + (1 - share) * (DRAG * _around(posture, place, 1) + FAR_DRAG * _around(posture, place, 2))
        - share * sensors[place].sag * max(0.0, 1 - _beside(posture, place))
        for place, share in enumerate(posture)
    )


def level(sensor: FingerSensor, share: float) -> float:
    """Return the raw value of a finger at `share`, without noise."""
    return sensor.bent + share * (sensor.straight - sensor.bent)


def _around(posture: Posture, place: int, distance: int) -> float:
    """Return the sum of the positions of the fingers at `distance`."""
    return sum(posture[there] for there in (place - distance, place + distance) if 0 <= there < len(posture))


def _beside(posture: Posture, place: int) -> float:
    """Return the position of the neighbour of `place` towards the middle of the hand."""
    return posture[place + 1 if place == 0 else place - 1]


class _Unsteadiness:
    """The noise, wander and drift of a still finger, in raw units."""

    def __init__(self, sensor: FingerSensor, rate_hz: float, chance: random.Random) -> None:
        self._chance = chance
        self._noise = sensor.noise
        self._keep = math.exp(-1 / (WANDER_S * rate_hz))
        kept = self._keep**2
        self._kick = sensor.wander * math.sqrt((1 - kept) ** 3 / (1 + kept))
        self._drift_keep = math.exp(-1 / (DRIFT_S * rate_hz))
        self._drift_kick = sensor.drift * math.sqrt(1 - self._drift_keep**2)
        self._drift_most = MAX_DRIFT_SIGMAS * sensor.drift
        self._push = self._wander = 0.0
        self._drift = chance.gauss(0, sensor.drift) * 0.5
        for _ in range(round(10 * WANDER_S * rate_hz)):
            self._step()

    def next(self) -> float:
        self._step()
        return self._wander + self._drift + self._chance.gauss(0, self._noise)

    def _step(self) -> None:
        self._push = self._keep * self._push + self._chance.gauss(0, self._kick)
        self._wander = self._keep * self._wander + self._push
        drift = self._drift_keep * self._drift + self._chance.gauss(0, self._drift_kick)
        self._drift = max(-self._drift_most, min(self._drift_most, drift))


def _five(values: Iterable[float]) -> Posture:
    thumb, index, middle, ring, little = values
    return thumb, index, middle, ring, little
