"""Signals: what a sensor measures, and the samples that it sends."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover.messages import number_text


class SignalKind(StrEnum):
    """What is measured, in the four groups of ROS4HC (Table 1 there, and mood and gait)."""

    # Physiological: waveforms first,
    ECG = "ecg"
    PPG = "ppg"
    EDA = "eda"
    EMG = "emg"
    EEG = "eeg"
    EOG = "eog"
    ICG = "icg"
    BCG = "bcg"
    RESPIRATION = "respiration"
    # then values that the device computes
    HEART_RATE = "heartRate"
    INTER_BEAT_INTERVAL = "interBeatInterval"
    BREATHING_RATE = "breathingRate"
    HEART_RATE_VARIABILITY = "heartRateVariability"
    SPO2 = "spo2"
    SKIN_TEMPERATURE = "skinTemperature"
    CARDIAC_OUTPUT = "cardiacOutput"
    STROKE_VOLUME = "strokeVolume"
    # Physical
    ACCELERATION = "acceleration"
    ANGULAR_VELOCITY = "angularVelocity"
    MAGNETIC_FIELD = "magneticField"
    PRESSURE_MAP = "pressureMap"
    JOINT_ANGLES = "jointAngles"
    JOINT_MOMENTS = "jointMoments"
    # Activity monitoring
    PRESENCE = "presence"
    DISTANCE = "distance"
    MOVEMENT = "movement"
    POSTURE = "posture"
    STEPS = "steps"
    GAIT = "gait"
    ACTIVITY = "activity"
    SLEEP = "sleep"
    MOOD = "mood"
    BLINK = "blink"
    FIXATION = "fixation"
    SACCADE = "saccade"
    GAZE = "gaze"
    EYE_STATE = "eyeState"
    """Diameters of the pupils, how far the lids are open, and where the eyeballs and their axes are."""


GAIT_CHANNELS: Final = (
    "speed_mps",
    "cadence_per_min",
    "step_length_m",
    "stride_time_s",
    "stance_fraction",
    "double_support_fraction",
    "asymmetry",
)
"""Of each stride; they have the names of the fields of the message `Gait`."""
EYE_EVENTS: Final = frozenset({SignalKind.BLINK, SignalKind.FIXATION, SignalKind.SACCADE})
"""Signals that come when something has happened, and not while nothing does."""
EYE_STREAMS: Final = frozenset({SignalKind.GAZE, SignalKind.EYE_STATE})
"""While an eye tracker sends these, the absence of an event means that nothing has happened."""


class ClockKind(StrEnum):
    """Which clock the times of samples come from."""

    DEVICE = "device"  # stamped by the sensor, mapped to our clock
    ARRIVAL = "arrival"  # stamped when the packet was received
    RECORDING = "recording"  # as stored in a recording


@dataclass(frozen=True, slots=True)
class SignalInfo:
    """A signal of one sensor.

    `unit` is a code of UN/CEFACT Recommendation 20, of one channel. `rate_hz` is None for values that come at
    irregular times. `min_value` and `max_value` bound what the sensor can measure: a value at them is
    saturated.
    """

    kind: SignalKind
    unit: str
    rate_hz: float | None
    channels: tuple[str, ...] = ("",)
    min_value: float = -np.inf
    max_value: float = np.inf
    resolution: float | None = None
    method: str = ""
    """How the device measures, or the lead of an ECG: `chest strap, one lead`, `PPG at the wrist`."""

    def __post_init__(self) -> None:
        if self.rate_hz is not None and not 0 < self.rate_hz <= 100_000:
            raise ValueError(
                f"rate_hz of {self.kind} is {number_text(self.rate_hz)}; it must be in 0..100,000 Hz, or None"
            )
        if not self.channels:
            raise ValueError(f"{self.kind} needs at least one channel")


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Consecutive samples of a signal of one sensor: what one packet brings.

    `values` has one row per sample and one column per channel, in the unit of the signal. NaN is what
    the device could not measure. The first sample was taken at `start_s`, in s since 1970, with
    `uncertainty_s`; the others follow at `info.rate_hz`, or, for irregular signals, at `times_s`.

    An empty packet of events says that nothing happened until `start_s`.
    """

    source: str
    """The id of the sensor, unique in the service: `polar-h10-1`."""
    info: SignalInfo
    start_s: float
    values: NDArray[np.float64]
    times_s: NDArray[np.float64] | None = None
    clock: ClockKind = ClockKind.ARRIVAL
    uncertainty_s: float = 0.0
    quality: float = 1.0
    """0 to 1, as the device or its driver reports it; processing lowers it further."""
    has_contact: bool | None = None
    """None: the device does not measure whether it touches the body."""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape[1] != len(self.info.channels):
            raise ValueError(
                f"values of {self.source} have the shape {self.values.shape}; {self.info.kind} needs "
                f"(samples, {len(self.info.channels)})"
            )
        if self.info.rate_hz is None and (self.times_s is None or len(self.times_s) != len(self.values)):
            raise ValueError(
                f"{self.info.kind} of {self.source} has no rate, so it needs one time per sample"
            )

    @property
    def end_s(self) -> float:
        """Return the time of the last sample in s since 1970."""
        times_s = self.sample_times_s()
        return float(times_s[-1]) if len(times_s) else self.start_s

    def sample_times_s(self) -> NDArray[np.float64]:
        """Return the time of each sample in s since 1970."""
        if self.times_s is not None or self.info.rate_hz is None:
            return np.empty(0) if self.times_s is None else self.times_s
        times: NDArray[np.float64] = self.start_s + np.arange(len(self.values)) / self.info.rate_hz
        return times


class LinkState(StrEnum):
    """The connection to a sensor."""

    SEARCHING = "searching"
    PAIRING = "pairing"
    CONNECTED = "connected"
    LOST = "lost"
    FAULT = "fault"


class SensorFault(StrEnum):
    """What makes samples of a sensor unusable for a time."""

    GAP = "gap"
    CLOCK_JUMP = "clockJump"
    NO_CONTACT = "noContact"
    SATURATED = "saturated"
    FLAT = "flat"
    ARTEFACT = "artefact"
    RECONNECTED = "reconnected"
    RATE = "rate"  # the samples come at another rate than the device says
    UNIT = "unit"  # the values changed their order of magnitude
    LATE = "late"  # a busy machine or link delivers late; the samples themselves are good


SILENT: Final = frozenset({SensorFault.GAP, SensorFault.LATE})
"""Faults that say nothing against the values before them: these are stale, not implausible."""


@dataclass(frozen=True, slots=True)
class SensorReport:
    """News of a sensor that are no samples. None: unchanged or not known."""

    source: str
    at_s: float
    link: LinkState | None = None
    battery: float | None = None
    """0 to 1."""
    has_contact: bool | None = None
    fault: SensorFault | None = None
    text: str = ""
    """What a person should know: why the link was lost, what is wrong."""
    details: dict[str, float] = field(default_factory=dict)
    """Figures: `gap_s`, `jump_s`, `uncertainty_s`."""
    kind: SignalKind | None = None
    """The signal that the fault concerns; None: all of this sensor."""
