"""What sensors measure on a simulated person: samples of a signal at times, vectorized, and events."""

from collections.abc import Callable
from typing import Final

import numpy as np

from handover_body.drivers.simulated import circulation, gait
from handover_body.drivers.simulated.beat_waves import BeatWave, Floats, beat_waves
from handover_body.drivers.simulated.eyes import EYELID_MM, PUPIL_MM
from handover_body.drivers.simulated.person import Posture, SimulatedPerson
from handover_body.model.signals import GAIT_CHANNELS, SignalInfo, SignalKind

Wave = Callable[[SimulatedPerson, Floats, np.random.Generator], Floats]
Events = Callable[[SimulatedPerson, float, float], list[tuple[float, ...]]]

GRAVITY: Final = 9.80665
MAT_ROWS: Final = 3
MAT_COLUMNS: Final = 4

_ECG_WAVES: Final[tuple[BeatWave, ...]] = (
    (110.0, -0.17, 0.025, True),
    (-120.0, -0.028, 0.010, False),
    (1100.0, 0.0, 0.011, False),
    (-230.0, 0.028, 0.010, False),
    (280.0, 0.26, 0.045, True),
)
"""In microvolt: P, Q, R, S, T."""
_PPG_WAVES: Final[tuple[BeatWave, ...]] = ((1.0, 0.25, 0.09, True), (0.35, 0.50, 0.10, True))
_POSTURES: Final[dict[Posture, tuple[float, float, float]]] = {
    "sitting": (0.10, 0.05, 0.994),
    "standing": (0.0, 0.0, 1.0),
    "lying": (0.0, 0.995, 0.10),
    "lyingLeft": (0.98, 0.15, 0.10),
    "lyingRight": (-0.98, 0.15, 0.10),
    "prone": (0.0, -0.995, 0.10),
}

_FIXED_SIDE: Final = np.array([0.6, 0.64, 0.48])
MOOD_EVERY_S: Final = 60.0
UNPLEASANT_FROM: Final = 0.6
"""The share of the heart rate reserve, near the ventilatory threshold, above which effort is unpleasant."""


def ecg(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return one lead in microvolt, with wander of the baseline and noise of muscles that grows with effort."""
    wave = beat_waves(person, times_s, _ECG_WAVES)
    wander = 60.0 * person.breath_at(times_s)
    noise = random.normal(0, 8.0 + 25.0 * person.effort, len(times_s))
    return (wave + wander + noise)[:, None]


def ppg(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return a pulse wave in the units of the converter, 20,000 to 80,000, with breathing in its amplitude."""
    breath = person.breath_at(times_s)
    wave = beat_waves(person, times_s, _PPG_WAVES) * (1 + 0.1 * breath)
    noise = random.normal(0, 0.01 + 0.05 * person.effort, len(times_s))
    values: Floats = 50_000 + 4_000 * (wave + noise) + 800 * breath
    return values[:, None]


def respiration(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the expansion of a belt, -1.5 to 1.5."""
    return (person.breath_at(times_s) + random.normal(0, 0.01, len(times_s)))[:, None]


def eda(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the conductance of the skin in microsiemens: a level that follows strain, and responses."""
    load = (person.heart_rate_bpm - person.rest_bpm) / (person.max_bpm - person.rest_bpm)
    tonic = 4.0 + 6.0 * load + 0.3 * np.sin(2 * np.pi * times_s / 90)
    since_s = np.mod(times_s, 25.0)  # one response in 25 s: rise 0.75 s, fall 3 s
    phasic = (0.3 + load) * (np.exp(-since_s / 3.0) - np.exp(-since_s / 0.75))
    return (tonic + phasic + random.normal(0, 0.005, len(times_s)))[:, None]


def emg(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the muscle of an arm in microvolt: bursts twice in 3 s whose size follows effort."""
    burst = 0.5 + 0.5 * np.sign(np.sin(2 * np.pi * times_s / 1.5))
    values: Floats = random.normal(0, 1, len(times_s)) * (4.0 + 350.0 * person.effort * burst)
    return values[:, None]


def eeg(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return a channel in microvolt: alpha waves and noise."""
    alpha = 15 * np.sin(2 * np.pi * 10.2 * times_s) * (1 + np.sin(2 * np.pi * 0.2 * times_s))
    values: Floats = alpha + random.normal(0, 6.0, len(times_s))
    return values[:, None]


def acceleration(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return three axes at the chest in m/s²: gravity by posture, and steps of a walk, or from effort 0.1 on."""
    upright = np.array(_POSTURES[person.posture])
    values = np.tile(GRAVITY * upright, (len(times_s), 1)) + random.normal(0, 0.05, (len(times_s), 3))
    speed_mps = person.walking_mps
    if person.steps_hz > 0:
        size = 1.0 + 5.0 * person.effort if speed_mps is None else 0.6 + 1.4 * speed_mps
        phase = person.gait_at(times_s)
        values += size * np.sin(phase)[:, None] * upright + np.outer(np.sin(phase / 2), [0.8, 0.5, 0.0])
    return values


def pressure_map(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return 3 by 4 cells, 0 to 4095: two thighs and the seat bones, leaning with breath and movement."""
    rows, columns = np.mgrid[0:MAT_ROWS, 0:MAT_COLUMNS]
    sway = 0.15 * person.breath_at(times_s) + 0.3 * person.effort * np.sin(2 * np.pi * 0.2 * times_s)
    right, forwards = person.lean
    shape = np.zeros((len(times_s), MAT_ROWS * MAT_COLUMNS))
    for column in (0.7, 2.3):
        across = columns.ravel() - column - 0.8 * right - 0.3 * sway[:, None]
        distance = (rows - 1.2 + 0.8 * forwards).ravel() ** 2 + across**2
        shape += 1500 * np.exp(-distance / 1.2)
    if person.posture == "standing":
        shape *= 0
    return np.clip(np.round(shape + random.normal(0, 6, shape.shape)), 0, 4095)


def magnetic_field(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the field of the earth at the chest in microtesla: 45 downwards and 20 to a fixed side."""
    up = np.array(_POSTURES[person.posture])
    side = _FIXED_SIDE - (_FIXED_SIDE @ up) * up
    field: Floats = -45.0 * up + 20.0 * side / np.linalg.norm(side)
    return field + random.normal(0, 0.3, (len(times_s), 3))


def heart_rate(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return what a strap computes: the mean of the last beats."""
    beats = np.array([beat for beat in person.beats_s if beat <= times_s[-1]])
    rate = 60.0 / np.diff(beats[-6:]).mean() if len(beats) > 1 else np.nan
    return np.full((len(times_s), 1), np.round(rate))


def breathing_rate(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return breaths per minute as a radar does: whole numbers with an error of about 1."""
    rate = person.breathing_rate
    return np.full((len(times_s), 1), round(rate + random.normal(0, 0.8)) if rate else np.nan)


def spo2(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return percent; the saturation of a healthy person."""
    return np.round(97.5 + random.normal(0, 0.5, (len(times_s), 1))).clip(90, 100)


def skin_temperature(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return degrees Celsius at the wrist."""
    return 33.0 + 0.5 * person.effort + random.normal(0, 0.05, (len(times_s), 1))


def movement(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the movement that a radar sees, 0 to 100."""
    seen = 2 + 90 * person.effort if person.movement is None else person.movement
    return np.clip(np.round(seen + random.normal(0, 2, (len(times_s), 1))), 0, 100)


def eog(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the vertical and the horizontal lead in microvolt: the gaze, blinks, noise, and slow drift."""
    gaze = person.eyes.gaze_at(times_s)
    blink = 250.0 * (1 - person.eyes.lids_at(times_s))  # Bell's phenomenon and the lid over the cornea
    drift = 20.0 * np.sin(2 * np.pi * 0.03 * times_s)
    noise = random.normal(0, 4.0, (len(times_s), 2))
    return np.column_stack((8.0 * gaze[:, 1] + blink + drift, 14.0 * gaze[:, 0] + drift)) + noise


def gaze(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return where the eyes look in degrees, to the right and up, with the noise of a video eye tracker."""
    return person.eyes.gaze_at(times_s) + random.normal(0, 0.05, (len(times_s), 2))


def eye_state(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the pupils, which follow effort, and the openings of the lids, left and right in mm."""
    pupil = PUPIL_MM + 1.2 * person.effort + 0.1 * np.sin(2 * np.pi * 0.2 * times_s)
    lids = EYELID_MM * person.eyes.lids_at(times_s)
    pupils = pupil[:, None] + random.normal(0, 0.03, (len(times_s), 2))
    return np.column_stack((pupils, np.clip(lids[:, None] + random.normal(0, 0.1, (len(times_s), 2)), 0, 20)))


def presence(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return 1: somebody is there."""
    return np.ones((len(times_s), 1))


def distance(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return how far the chest is from a radar in m: it moves with lean and breath."""
    chest_m = 1.2 - 0.2 * person.lean[1] - 0.004 * person.breath_at(times_s)
    return (chest_m + random.normal(0, 0.002, len(times_s)))[:, None]


def moods(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return what the person says of the mood every minute: valence and arousal, -1 to 1.

    Effort excites; it is pleasant until the ventilatory threshold, and less so above it (Ekkekakis, Parfitt,
    Petruzzello 2011, Sports Med 41:641). The figures are ours.
    """
    asked = np.arange(np.ceil(begin_s / MOOD_EVERY_S), np.ceil(end_s / MOOD_EVERY_S))
    beyond = max(person.strain - UNPLEASANT_FROM, 0.0) / (1 - UNPLEASANT_FROM)
    return [(float(number) * MOOD_EVERY_S, 0.5 - 1.2 * beyond, 1.4 * person.strain - 0.4) for number in asked]


def blinks(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return the end of each blink that ends in a time, and its duration."""
    return [(end, end - begin) for begin, end in person.eyes.blinks if begin_s <= end < end_s]


def fixations(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return the end of each fixation that ends in a time, its duration, and the gaze."""
    ended = [eye_movement for eye_movement in person.eyes.movements if begin_s <= eye_movement.end_s < end_s]
    return [
        (eye_movement.end_s, eye_movement.end_s - eye_movement.begin_s, *eye_movement.end)
        for eye_movement in ended
        if not eye_movement.amplitude_deg
    ]


def saccades(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return the end of each saccade that ends in a time, duration, gaze at its end, size, peak velocity."""
    ended = [eye_movement for eye_movement in person.eyes.movements if begin_s <= eye_movement.end_s < end_s]
    return [
        (
            eye_movement.end_s,
            eye_movement.end_s - eye_movement.begin_s,
            *eye_movement.end,
            eye_movement.amplitude_deg,
            eye_movement.peak_deg_s,
        )
        for eye_movement in ended
        if eye_movement.amplitude_deg
    ]


_MAT_CELLS: Final = tuple(f"r{row}c{column}" for row in range(MAT_ROWS) for column in range(MAT_COLUMNS))
WAVES: Final[dict[SignalKind, tuple[SignalInfo, Wave]]] = {
    info.kind: (info, wave)
    for info, wave in (
        (SignalInfo(SignalKind.ECG, "D82", 130.0, ("I",), -20_000, 20_000, 1.0, "chest strap, one lead"), ecg),
        (SignalInfo(SignalKind.PPG, "C62", 100.0, ("ir",), 0, 262_143, 1.0, "infrared at the finger"), ppg),
        (SignalInfo(SignalKind.RESPIRATION, "C62", 25.0, ("belt",), -4, 4, None, "belt"), respiration),
        (SignalInfo(SignalKind.EDA, "D80", 10.0, ("palm",), 0, 60, 0.01, "palm"), eda),
        (SignalInfo(SignalKind.EMG, "D82", 500.0, ("arm",), -5_000, 5_000, 1.0, "biceps"), emg),
        (SignalInfo(SignalKind.EEG, "D82", 250.0, ("O1",), -2_000, 2_000, 0.1, "O1"), eeg),
        (SignalInfo(SignalKind.ACCELERATION, "MSK", 50.0, ("x", "y", "z"), -78.5, 78.5, None, "chest"), acceleration),
        (SignalInfo(SignalKind.PRESSURE_MAP, "C62", 10.0, _MAT_CELLS, 0, 4096, 1.0, "seat, 3 by 4 cells"), pressure_map),
        (SignalInfo(SignalKind.HEART_RATE, "BPM", 1.0, ("",), 0, 255, 1.0, "chest strap"), heart_rate),
        (SignalInfo(SignalKind.BREATHING_RATE, "C94", 1 / 3, ("",), 0, 60, 1.0, "radar 60 GHz"), breathing_rate),
        (SignalInfo(SignalKind.SPO2, "P1", 1.0, ("",), 0, 101, 1.0, "finger"), spo2),
        (SignalInfo(SignalKind.SKIN_TEMPERATURE, "CEL", 1.0, ("",), 10, 50, 0.1, "wrist"), skin_temperature),
        (SignalInfo(SignalKind.MOVEMENT, "C62", 1.0, ("",), -1, 101, 1.0, "radar 60 GHz"), movement),
        (SignalInfo(SignalKind.EOG, "D82", 250.0, ("vertical", "horizontal"), -3_000, 3_000, 0.1, "electrodes around the eyes"), eog),
        (SignalInfo(SignalKind.GAZE, "DD", 200.0, ("gaze_x", "gaze_y"), -90, 90, None, "eye tracker"), gaze),
        (SignalInfo(SignalKind.EYE_STATE, "MMT", 200.0, ("pupil_left_mm", "pupil_right_mm", "eyelid_left_mm", "eyelid_right_mm"), -1, 25, None, "eye tracker"), eye_state),
        (SignalInfo(SignalKind.ICG, "OHM", 250.0, ("impedance",), 5, 60, None, "band electrodes at neck and thorax"), circulation.impedance),
        (SignalInfo(SignalKind.BCG, "NEW", 125.0, ("axis",), -100, 100, None, "bed, force along the body"), circulation.recoil),
        (SignalInfo(SignalKind.HEART_RATE_VARIABILITY, "C26", 0.2, ("",), 0, 500, None, "chest strap, RMSSD of 10 s"), circulation.variability),
        (SignalInfo(SignalKind.STROKE_VOLUME, "MLT", 1.0, ("",), 0, 300, None, "impedance cardiography"), circulation.stroke_volume),
        (SignalInfo(SignalKind.CARDIAC_OUTPUT, "L2", 1.0, ("",), 0, 50, None, "impedance cardiography"), circulation.cardiac_output),
        (SignalInfo(SignalKind.ANGULAR_VELOCITY, "2A", 50.0, ("x", "y", "z"), -35, 35, None, "left shank"), gait.shank_velocity),
        (SignalInfo(SignalKind.MAGNETIC_FIELD, "D81", 25.0, ("x", "y", "z"), -1_200, 1_200, None, "chest"), magnetic_field),
        (SignalInfo(SignalKind.JOINT_ANGLES, "DD", 100.0, gait.JOINTS, -180, 180, None, "motion capture"), gait.joint_angles),
        (SignalInfo(SignalKind.JOINT_MOMENTS, "NU", 100.0, gait.JOINTS, -500, 500, None, "motion capture and force plates"), gait.joint_moments),
        (SignalInfo(SignalKind.PRESENCE, "C62", 1.0, ("",), -1, 2, 1.0, "radar 60 GHz"), presence),
        (SignalInfo(SignalKind.DISTANCE, "MTR", 1.0, ("",), 0, 10, None, "radar 60 GHz"), distance),
        (SignalInfo(SignalKind.STEPS, "C62", 1.0, ("",), -1, 4_294_967_295, 1.0, "step counter"), gait.steps),
    )
}  # fmt: skip
"""The signals that can be simulated, with the function that makes them."""
EVENTS: Final[dict[SignalKind, tuple[SignalInfo, Events]]] = {
    info.kind: (info, events)
    for info, events in (
        (SignalInfo(SignalKind.BLINK, "SEC", None, ("duration_s",), 0, 60, None, "eye tracker"), blinks),
        (SignalInfo(SignalKind.FIXATION, "DD", None, ("duration_s", "gaze_x", "gaze_y"), -90, 90, None, "eye tracker"), fixations),
        (SignalInfo(SignalKind.SACCADE, "DD", None, ("duration_s", "gaze_x", "gaze_y", "amplitude_deg", "peak_velocity"), -90, 1000, None, "eye tracker"), saccades),
        (SignalInfo(SignalKind.INTER_BEAT_INTERVAL, "C26", None, ("",), 0, 64_000, None, "chest strap"), circulation.intervals),
        (SignalInfo(SignalKind.GAIT, "C62", None, GAIT_CHANNELS, -1, 300, None, "insoles"), gait.strides),
        (SignalInfo(SignalKind.MOOD, "C62", None, ("valence", "arousal"), -2, 2, None, "asked every minute"), moods),
    )
}  # fmt: skip
"""Those that come irregularly: the time of each event, then its values."""
