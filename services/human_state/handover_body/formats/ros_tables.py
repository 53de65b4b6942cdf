"""Which message and field of `handover_human_msgs` stands for which signal and feature."""

from collections.abc import Mapping, Sequence
from typing import Final

from handover_body.model.features import FeatureName, Status
from handover_body.model.signals import GAIT_CHANNELS, ClockKind, SignalKind

SERIES: Final[Mapping[SignalKind, str]] = {
    SignalKind.ECG: "Ecg",
    SignalKind.PPG: "Ppg",
    SignalKind.EDA: "Eda",
    SignalKind.EMG: "Emg",
    SignalKind.EEG: "Eeg",
    SignalKind.EOG: "Eog",
    SignalKind.ICG: "Icg",
    SignalKind.BCG: "Bcg",
    SignalKind.RESPIRATION: "Respiration",
    SignalKind.ACCELERATION: "Acceleration",
    SignalKind.ANGULAR_VELOCITY: "AngularVelocity",
    SignalKind.MAGNETIC_FIELD: "MagneticField",
    SignalKind.JOINT_ANGLES: "JointAngles",
    SignalKind.JOINT_MOMENTS: "JointMoments",
}
SCALARS: Final[Mapping[SignalKind, tuple[str, str, str]]] = {
    SignalKind.HEART_RATE: ("HeartRate", "rate_bpm", "BPM"),
    SignalKind.BREATHING_RATE: ("BreathingRate", "rate_per_min", "C94"),
    SignalKind.SPO2: ("Spo2", "percent", "P1"),
    SignalKind.SKIN_TEMPERATURE: ("SkinTemperature", "celsius", "CEL"),
    SignalKind.STROKE_VOLUME: ("StrokeVolume", "millilitres", "MLT"),
    SignalKind.CARDIAC_OUTPUT: ("CardiacOutput", "litres_per_min", "L2"),
    SignalKind.DISTANCE: ("Distance", "metres", "MTR"),
    SignalKind.MOVEMENT: ("Movement", "movement", ""),
}
"""Type, field and unit."""
BY_CHANNEL: Final[Mapping[SignalKind, tuple[str, tuple[str, ...]]]] = {
    SignalKind.GAIT: ("Gait", GAIT_CHANNELS),
    SignalKind.MOOD: ("Mood", ("valence", "arousal")),
    SignalKind.EYE_STATE: (
        "EyeState",
        (
            "pupil_left_mm",
            "pupil_right_mm",
            "eyelid_left_mm",
            "eyelid_right_mm",
            "eyelid_top_left_rad",
            "eyelid_bottom_left_rad",
            "eyelid_top_right_rad",
            "eyelid_bottom_right_rad",
            "eyeball_left_x_mm",
            "eyeball_left_y_mm",
            "eyeball_left_z_mm",
            "eyeball_right_x_mm",
            "eyeball_right_y_mm",
            "eyeball_right_z_mm",
            "axis_left_x",
            "axis_left_y",
            "axis_left_z",
            "axis_right_x",
            "axis_right_y",
            "axis_right_z",
        ),
    ),
}
"""Type, and the fields that have the names of channels; NaN is a field that is not measured."""
EYES: Final[Mapping[SignalKind, int]] = {
    SignalKind.BLINK: 1,
    SignalKind.FIXATION: 2,
    SignalKind.SACCADE: 3,
    SignalKind.GAZE: 4,
}
"""The constants of `EyeEvent`."""
EYE_OF: Final = {number: kind for kind, number in EYES.items()}
GAZE: Final = ("gaze_x", "gaze_y")
DURATION: Final = ("duration_s",)
OF_MOVEMENTS: Final = ("amplitude_deg", "peak_velocity")
KIND_OF: Final = {name: kind for kind, name in SERIES.items()} | {
    name: kind for kind, (name, _, _) in SCALARS.items()
}
INTERVALS: Final = {"SEC": 1.0, "C26": 1e-3}
"""Factor to s by unit."""
CLOCKS: Final = {ClockKind.DEVICE: 1, ClockKind.ARRIVAL: 2, ClockKind.RECORDING: 3}
CLOCK_OF: Final = {number: clock for clock, number in CLOCKS.items()}
VALIDITY: Final = {Status.VALID: 1, Status.STALE: 2, Status.IMPLAUSIBLE: 3}
STATUS_OF: Final = {number: status for status, number in VALIDITY.items()}
CONTACT: Final = {None: 0, True: 1, False: 2}
CONTACT_OF: Final = {0: None, 1: True, 2: False}

TYPED: Final[Mapping[FeatureName, tuple[str, str]]] = {
    FeatureName.HEART_RATE: ("HeartRate", "rate_bpm"),
    FeatureName.BREATHING_RATE: ("BreathingRate", "rate_per_min"),
    FeatureName.HRV_RMSSD: ("HeartRateVariability", "rmssd_ms"),
    FeatureName.HRV_SDNN: ("HeartRateVariability", "sdnn_ms"),
    FeatureName.HRV_LF_HF: ("HeartRateVariability", "lf_hf"),
    FeatureName.SPO2: ("Spo2", "percent"),
    FeatureName.SKIN_TEMPERATURE: ("SkinTemperature", "celsius"),
    FeatureName.MOVEMENT: ("Movement", "movement"),
    FeatureName.POSTURE: ("Posture", "posture"),
    FeatureName.ACTIVITY: ("Activity", "activity"),
    FeatureName.EXERTION_LEVEL: ("Strain", "exertion"),
    FeatureName.FATIGUE: ("Strain", "fatigue"),
    FeatureName.STRESS: ("Strain", "stress"),
    FeatureName.BLINK_RATE: ("EyeActivity", "blink_rate_per_min"),
    FeatureName.BLINK_DURATION: ("EyeActivity", "blink_duration_ms"),
    FeatureName.FIXATION_DURATION: ("EyeActivity", "fixation_duration_ms"),
    FeatureName.SACCADE_RATE: ("EyeActivity", "saccade_rate_hz"),
    FeatureName.SACCADE_AMPLITUDE: ("EyeActivity", "saccade_amplitude_deg"),
    FeatureName.PUPIL_DIAMETER: ("EyeActivity", "pupil_diameter_mm"),
}
UNKNOWN_FIELDS: Final[Mapping[str, Sequence[str]]] = {
    "HeartRateVariability": ("rmssd_ms", "sdnn_ms", "lf_hf"),
    "Strain": ("exertion", "fatigue", "stress"),
    "EyeActivity": (
        "blink_rate_per_min",
        "blink_duration_ms",
        "fixation_duration_ms",
        "saccade_rate_hz",
        "saccade_amplitude_deg",
        "pupil_diameter_mm",
    ),
    "Posture": ("inclination_rad",),
}
"""Fields that are NaN where they are not computed."""
