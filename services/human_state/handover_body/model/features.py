"""Features: values of one sensor and one person, computed from samples, with quality and status."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

MIN_QUALITY: Final = 0.5
"""A value with less does not count, and is never `valid`."""


class FeatureName(StrEnum):
    """The attributes of a HumanState, and features that only recordings and pages have."""

    HEART_RATE = "heartRate"
    BREATHING_RATE = "breathingRate"
    HRV_RMSSD = "hrvRmssd"
    HRV_SDNN = "hrvSdnn"
    HRV_LF_HF = "hrvLfHf"
    SPO2 = "spo2"
    EDA_TONIC = "edaTonic"
    EDA_PHASIC = "edaPhasic"
    EMG_ENVELOPE = "emgEnvelope"
    SKIN_TEMPERATURE = "skinTemperature"
    MOVEMENT = "movement"
    """Of an accelerometer: the mean amplitude deviation in g, 1 at most."""
    BODY_MOVEMENT = "bodyMovement"
    """What a radar sees of the body, in percent."""
    STEPS = "steps"
    CADENCE = "cadence"
    ACTIVITY = "activity"
    DAILY_ACTIVITY = "dailyActivity"
    POSTURE = "posture"
    SLEEP_POSITION = "sleepPosition"
    APNOEA_EVENT = "apnoeaEvent"
    WEAR_STATE = "wearState"
    EXERTION_LEVEL = "exertionLevel"
    FATIGUE = "fatigue"
    STRESS = "stress"
    BLINK_RATE = "blinkRate"
    BLINK_DURATION = "blinkDuration"
    FIXATION_DURATION = "fixationDuration"
    SACCADE_RATE = "saccadeRate"
    SACCADE_AMPLITUDE = "saccadeAmplitude"
    PUPIL_DIAMETER = "pupilDiameter"
    CENTRE_OF_PRESSURE_X = "copX"
    CENTRE_OF_PRESSURE_Y = "copY"
    LOAD = "load"
    ACTIVE_CELLS = "activeCells"


UNITS: dict[FeatureName, str] = {
    FeatureName.HEART_RATE: "BPM",
    FeatureName.BREATHING_RATE: "C94",
    FeatureName.HRV_RMSSD: "C26",
    FeatureName.HRV_SDNN: "C26",
    FeatureName.SPO2: "P1",
    FeatureName.EDA_TONIC: "D80",  # microsiemens; phasic too
    FeatureName.EDA_PHASIC: "D80",
    FeatureName.EMG_ENVELOPE: "D82",  # microvolt
    FeatureName.SKIN_TEMPERATURE: "CEL",
    FeatureName.BODY_MOVEMENT: "P1",
    FeatureName.CADENCE: "C94",
    FeatureName.BLINK_RATE: "C94",
    FeatureName.BLINK_DURATION: "C26",
    FeatureName.FIXATION_DURATION: "C26",
    FeatureName.SACCADE_RATE: "HTZ",
    FeatureName.SACCADE_AMPLITUDE: "DD",
    FeatureName.PUPIL_DIAMETER: "MMT",
    FeatureName.CENTRE_OF_PRESSURE_X: "MMT",
    FeatureName.CENTRE_OF_PRESSURE_Y: "MMT",
}
"""Codes of UN/CEFACT Recommendation 20; features without one are fractions, counts or texts."""


class Status(StrEnum):
    """Whether a value may be used. Only `valid` ones may raise a limit."""

    VALID = "valid"
    STALE = "stale"
    IMPLAUSIBLE = "implausible"


@dataclass(frozen=True, slots=True)
class Feature:
    """One value of one sensor.

    Invariant: a `valid` one has a quality of `MIN_QUALITY` at least; with less it becomes `implausible` here,
    so that a reader of the status needs no threshold.

    `at_s` is the time of the newest sample that it depends on, in s since 1970; `window_s` the length of the
    signal that it was computed from. `period_s` is the time to the next value while the signal lasts.
    """

    name: FeatureName
    source: str
    value: float | str
    at_s: float
    quality: float
    status: Status = Status.VALID
    method: str = ""
    """`ecg`, `ppg`, `radar`, `device`: how it was measured, with the version of our algorithm."""
    window_s: float = 0.0
    period_s: float = 1.0
    is_calibrated: bool = True
    """False: never feeds a limit (SpO2 of an uncalibrated sensor)."""

    def __post_init__(self) -> None:
        if self.status is Status.VALID and not self.quality >= MIN_QUALITY:
            object.__setattr__(self, "status", Status.IMPLAUSIBLE)
