"""How the heart follows effort: the dynamics of simulated people, and what a walk costs.

    body = Physiology.of_age(55)
    heart = Heart()
    heart = heart.step(body.walking_effort(1.2), 30.0, body)
    heart.rate_bpm(body)

Effort is the share of the oxygen uptake reserve, 0 at rest and 1 at the maximum; in the steady state the heart
rate takes the same share of its own reserve (Swain and Leutholtz 1997, Med Sci Sports Exerc 29:410).

| what | value | source |
|---|---|---|
| heart rate on a treadmill | time constant 57.5 s upwards, 54.4 s downwards | Hunt, Fankhauser, Saengsuwan 2015, BioMed Eng OnLine 14:117 |
| two lags in series | a third and two thirds of it | two lags fit better than one (Wang, Hunt 2021, BioMed Eng OnLine 20:83); the shares are ours |
| drift in long work | 10 % of the rise, 15 min | it begins after some 10 min (Coyle, González-Alonso 2001, Exerc Sport Sci Rev 29:88); the size is ours |
| oxygen of a walk | 3.5 + 0.1 s + 1.8 s g ml/kg/min, s in m/min, g the grade | ACSM; from 50 m/min on, less is extrapolated |
| maximum heart rate | 208 - 0.7 age | Tanaka, Monahan, Seals 2001 |
| stroke volume | rises by half up to 40 % of the reserve, then constant; more while lying | Åstrand, Cuddy, Saltin, Stenberg 1964, J Appl Physiol 19:268; 75, 110 and 95 ml are ours |
| aerobic capacity | 18.7 - 0.15 age (active), 16.6 - 0.16 age (sedentary) METs | Morris et al. 1993, J Am Coll Cardiol 22:175; men |

A person of 55 years who is not trained gains 25 bpm for each m/s, as the 24.2 (SD 8.3) of the 24 people of Hunt.
"""  # noqa: E501 - a table

import math
from dataclasses import dataclass, replace
from typing import Final

RISE_S: Final = 57.5
RECOVERY_S: Final = 54.4
FIRST_SHARE: Final = 1 / 3
"""The share of the first lag in the time constant."""
DRIFT_SHARE: Final = 0.10
DRIFT_S: Final = 900.0

UPRIGHT_STROKE_ML: Final = 75.0
LYING_STROKE_ML: Final = 95.0
MAX_STROKE_ML: Final = 110.0
FULL_STROKE_SHARE: Final = 0.4

MET: Final = 3.5
"""Oxygen uptake at rest in ml/kg/min."""
WALK_RATIO_M_MIN: Final = 0.0065
"""Step length over cadence in m/(steps/min), nearly constant in walking (Sekiya, Nagasaki 1998)."""


def maximum_of_age(age_years: float) -> float:
    """Return the maximum heart rate of an age (Tanaka)."""
    return 208 - 0.7 * age_years


def cadence_hz(speed_mps: float) -> float:
    """Return the steps per second of a walk; 1.8 at 1.3 m/s."""
    return math.sqrt(60 * max(speed_mps, 0.0) / WALK_RATIO_M_MIN) / 60


def speed_mps_of_cadence(steps_hz: float) -> float:
    """Return the speed of a walk with this cadence: the inverse of `cadence_hz`."""
    return WALK_RATIO_M_MIN * (60 * steps_hz) ** 2 / 60


def stroke_volume_ml(share: float, *, is_lying: bool = False) -> float:
    """Return what one beat pumps at a share of the heart rate reserve, 0 to 1."""
    at_rest = LYING_STROKE_ML if is_lying else UPRIGHT_STROKE_ML
    return at_rest + (MAX_STROKE_ML - at_rest) * min(max(share, 0.0) / FULL_STROKE_SHARE, 1.0)


@dataclass(frozen=True, slots=True)
class Physiology:
    """What is constant in a person: rates in bpm, oxygen in ml/kg/min, time constants in s."""

    rest_bpm: float = 65.0
    max_bpm: float = 185.0
    vo2_max: float = 35.0
    rise_s: float = RISE_S
    recovery_s: float = RECOVERY_S
    drift_share: float = DRIFT_SHARE

    def __post_init__(self) -> None:
        if not 30 <= self.rest_bpm < self.max_bpm <= 230:
            raise ValueError(
                f"a heart that beats {self.rest_bpm:g} at rest and {self.max_bpm:g} at most cannot be "
                "simulated; give 30 to 230 bpm, rest below maximum"
            )
        if not 2 * MET <= self.vo2_max <= 100:
            raise ValueError(f"vo2_max is {self.vo2_max:g} ml/kg/min; it must be {2 * MET:g} to 100")
        if not (1 <= self.rise_s <= 600 and 1 <= self.recovery_s <= 600):
            raise ValueError("rise_s and recovery_s must be 1 to 600 s")

    @classmethod
    def of_age(cls, age_years: float, *, is_active: bool = False, rest_bpm: float = 70.0) -> "Physiology":
        """Return a typical person. Raises `ValueError` for an age outside 14 to 90 years."""
        if not 14 <= age_years <= 90:
            raise ValueError(f"the age {age_years:g} is not in 14 to 90 years, for which the formulas hold")
        mets = 18.7 - 0.15 * age_years if is_active else 16.6 - 0.16 * age_years
        return cls(rest_bpm, maximum_of_age(age_years), MET * max(mets, 2.0))

    def walking_effort(self, speed_mps: float, grade: float = 0.0) -> float:
        """Return the effort of a walk at a speed and a grade (0.1: 10 m higher after 100 m), 0 to 1."""
        speed_m_min = 60 * max(speed_mps, 0.0)
        cost = (0.1 + 1.8 * max(grade, 0.0)) * speed_m_min
        return min(cost / (self.vo2_max - MET), 1.0)

    def speed_at(self, heart_rate_bpm: float) -> float:
        """Return the speed in m/s of a level walk that leads to a heart rate, before any drift; 0 at rest."""
        share = (heart_rate_bpm - self.rest_bpm) / (self.max_bpm - self.rest_bpm)
        return max(share, 0.0) * (self.vo2_max - MET) / 0.1 / 60


@dataclass(frozen=True, slots=True)
class Heart:
    """The state of the heart; each value is a share of the heart rate reserve. Frozen; the time is given.

    Invariants: with efforts of 0 to 1 the share is 0 to 1, whatever the steps; a step of two seconds at one
    effort equals two steps of one second, up to the coupling of the two lags.
    """

    first: float = 0.0
    second: float = 0.0
    drift: float = 0.0

    @classmethod
    def steady(cls, effort: float) -> "Heart":
        """Return the heart of a person who has worked so for minutes, before any drift."""
        effort = min(max(effort, 0.0), 1.0)
        return cls(effort, effort, 0.0)

    @property
    def share(self) -> float:
        """Return the share of the reserve without drift."""
        return self.second

    def step(self, effort: float, seconds: float, body: Physiology) -> "Heart":
        """Return the heart after `seconds` of an effort; an effort outside 0 to 1 counts as the bound."""
        effort = min(max(effort, 0.0), 1.0)
        first = _lag(self.first, effort, seconds, FIRST_SHARE, body)
        second = _lag(self.second, first, seconds, 1 - FIRST_SHARE, body)
        drift = self.drift + (second - self.drift) * -math.expm1(-seconds / DRIFT_S)
        return replace(self, first=first, second=second, drift=drift)

    def total(self, body: Physiology) -> float:
        """Return the share of the reserve with drift, 0 to 1."""
        return min(self.second + body.drift_share * self.drift, 1.0)

    def rate_bpm(self, body: Physiology) -> float:
        """Return the mean heart rate, without the variability from beat to beat."""
        return body.rest_bpm + self.total(body) * (body.max_bpm - body.rest_bpm)


def _lag(value: float, target: float, seconds: float, share: float, body: Physiology) -> float:
    """Return a first-order lag after `seconds`, exact for a constant target."""
    constant_s = share * (body.rise_s if target > value else body.recovery_s)
    return value + (target - value) * -math.expm1(-max(seconds, 0.0) / constant_s)
