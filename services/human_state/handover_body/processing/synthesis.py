"""Synthetic body signals with a known truth, seeded: for simulators, tests and measurements.

The ECG is a sum of Gaussian waves around each beat (P, Q, R, S, T), after the model of McSharry,
Clifford, Tarassenko and Smith, "A dynamical model for generating synthetic electrocardiogram signals",
IEEE Trans Biomed Eng 50(3), 2003. A ventricular ectopic beat comes early, is wide, has no P wave and an
inverted T wave, and a compensatory pause follows. An atrial one comes early and looks nearly normal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

Floats = NDArray[np.float64]
BeatKind = Literal["N", "V", "A"]
NoiseKind = Literal["muscle", "baseline", "electrode"]

WAVES: Final[dict[BeatKind, tuple[tuple[float, float, float], ...]]] = {
    # amplitude in mV, offset from the R peak in s at 60 bpm, standard deviation in s
    "N": (
        (0.12, -0.17, 0.022),
        (-0.10, -0.026, 0.009),
        (1.1, 0.0, 0.011),
        (-0.22, 0.026, 0.010),
        (0.28, 0.27, 0.05),
    ),
    "A": (
        (0.08, -0.15, 0.018),
        (-0.10, -0.026, 0.009),
        (1.0, 0.0, 0.011),
        (-0.20, 0.026, 0.010),
        (0.25, 0.26, 0.05),
    ),
    "V": ((1.3, 0.0, 0.034), (-0.45, 0.09, 0.035), (-0.35, 0.28, 0.06)),
}
LONGEST_WAVE_S: Final = 0.6


@dataclass(frozen=True, slots=True)
class TrueBeat:
    """The R peak of one synthetic beat: its time in s from the start of the signal, and its kind."""

    at_s: float
    kind: BeatKind


def synthetic_beats(
    duration_s: float,
    heart_rate_bpm: float | Callable[[float], float],
    seed: int,
    *,
    ectopic_share: float = 0.0,
    breathing_per_minute: float = 15.0,
    rmssd_s: float = 0.025,
) -> list[TrueBeat]:
    """Return the beats of a person whose intervals follow breathing and vary at random.

    `heart_rate_bpm` is a value or a function of the time in s. Half of the ectopic beats are ventricular.
    """
    random = np.random.default_rng(seed)
    beats: list[TrueBeat] = []
    at_s, pause_s = 0.4, 0.0
    while at_s < duration_s - 0.3:
        bpm = heart_rate_bpm(at_s) if callable(heart_rate_bpm) else heart_rate_bpm
        interval_s = 60 / bpm
        spread = min(1.0, interval_s) * rmssd_s
        interval_s += spread * (np.sin(2 * np.pi * at_s * breathing_per_minute / 60) + 0.4 * random.normal())
        kind: BeatKind = "N"
        if len(beats) > 3 and beats[-1].kind == "N" and random.random() < ectopic_share:
            kind = "V" if random.random() < 0.5 else "A"
        beats.append(TrueBeat(at_s - (0.3 * interval_s if kind != "N" else 0.0), kind))
        pause_s = (
            0.0 if kind != "A" else -0.2 * interval_s
        )  # the pause after an atrial beat is not compensatory
        at_s += interval_s + pause_s
    return beats


def ecg_of(
    beats: list[TrueBeat], duration_s: float, rate_hz: float, breathing_per_minute: float = 15.0
) -> Floats:
    """Return the ECG of `beats` in mV, its amplitude modulated by breathing."""
    ecg = np.zeros(round(duration_s * rate_hz))
    for number, beat in enumerate(beats):
        before_s = beat.at_s - beats[number - 1].at_s if number else 0.8
        # The T wave comes earlier at a fast heart (Bazett's root law); P and QRS change less.
        stretch = float(np.clip(np.sqrt(before_s), 0.6, 1.2))
        first = max(0, int((beat.at_s - LONGEST_WAVE_S) * rate_hz))
        last = min(len(ecg), int((beat.at_s + LONGEST_WAVE_S) * rate_hz) + 1)
        t = np.arange(first, last) / rate_hz - beat.at_s
        gain = 1 + 0.08 * np.sin(2 * np.pi * beat.at_s * breathing_per_minute / 60)
        for amplitude, offset_s, width_s in WAVES[beat.kind]:
            shift = offset_s * (stretch if abs(offset_s) > 0.1 else 1.0)
            ecg[first:last] += gain * amplitude * np.exp(-0.5 * ((t - shift) / width_s) ** 2)
    return ecg


def band_power(signal: Floats, rate_hz: float, lower_hz: float = 0.5, upper_hz: float = 40.0) -> float:
    """Return the mean power of `signal` between two frequencies, in its unit squared."""
    spectrum = np.abs(np.fft.rfft(signal - signal.mean())) ** 2 / len(signal) ** 2 * 2
    frequencies = np.fft.rfftfreq(len(signal), 1 / rate_hz)
    return float(spectrum[(frequencies >= lower_hz) & (frequencies <= upper_hz)].sum())


def _shaped(
    random: np.random.Generator, count: int, rate_hz: float, shape: Callable[[Floats], Floats]
) -> Floats:
    """Return Gaussian noise with the amplitude spectrum `shape`."""
    spectrum = np.fft.rfft(random.normal(size=count))
    frequencies = np.asarray(np.fft.rfftfreq(count, 1 / rate_hz), np.float64)
    return np.asarray(np.fft.irfft(spectrum * shape(frequencies), count), np.float64)


def ecg_noise(kind: NoiseKind, count: int, rate_hz: float, seed: int) -> Floats:
    """Return noise of an ECG with power 1 between 0.5 and 40 Hz.

    `muscle`: wide-band from 15 Hz on, in bursts. `baseline`: below 1 Hz. `electrode`: movements of the
    electrode, steps that decay within a second, and slow random drift up to 10 Hz.
    """
    random = np.random.default_rng(seed)
    seconds = count / rate_hz
    if kind == "muscle":
        noise = _shaped(random, count, rate_hz, lambda f: 1 / (1 + (15 / np.maximum(f, 0.1)) ** 4))
        knots_s = np.arange(0, seconds + 2, 2.0)
        bursts = np.interp(np.arange(count) / rate_hz, knots_s, random.uniform(0.4, 1.6, len(knots_s)))
        noise = noise * bursts
    elif kind == "baseline":
        noise = _shaped(random, count, rate_hz, lambda f: 1 / (1 + (f / 0.6) ** 4))
    else:
        noise = 0.3 * _shaped(random, count, rate_hz, lambda f: 1 / (1 + (f / 1.5) ** 2))
        steps = np.zeros(count)
        for at in random.integers(0, count, max(1, int(seconds / 3))):
            length = min(count - at, int(3 * rate_hz))
            rise = 1 - np.exp(-np.arange(length) / (0.05 * rate_hz))
            steps[at : at + length] += random.normal() * rise * np.exp(-np.arange(length) / (0.5 * rate_hz))
        noise = noise / max(noise.std(), 1e-12) + 2 * steps / max(steps.std(), 1e-12)
    return np.asarray(noise / np.sqrt(max(band_power(noise, rate_hz), 1e-12)), np.float64)


def add_ecg_noise(
    ecg: Floats,
    rate_hz: float,
    snr_db: float,
    seed: int,
    kinds: tuple[NoiseKind, ...] = ("muscle", "baseline", "electrode"),
) -> Floats:
    """Return `ecg` with noise of equal shares of `kinds`, at `snr_db` between 0.5 and 40 Hz."""
    noise = np.sum(
        [ecg_noise(kind, len(ecg), rate_hz, seed + 7919 * n) for n, kind in enumerate(kinds)], axis=0
    )
    wanted = band_power(ecg, rate_hz) / 10 ** (snr_db / 10)
    return np.asarray(ecg + noise * np.sqrt(wanted / band_power(noise, rate_hz)), np.float64)


def acceleration_of(activity: str, duration_s: float, rate_hz: float, seed: int) -> tuple[Floats, float]:
    """Return the acceleration in m/s2 (samples, 3) of a chest sensor, z upwards, and the number of steps.

    `activity` is `rest`, `sit` (small movements), `walk` (1.8 steps a second) or `run` (2.7).
    """
    random = np.random.default_rng(seed)
    count = round(duration_s * rate_hz)
    t = np.arange(count) / rate_hz
    acceleration = random.normal(0, 0.02, (count, 3))
    acceleration[:, 2] += 9.80665
    steps_hz = {"walk": 1.8, "run": 2.7}.get(activity, 0.0) * random.uniform(0.95, 1.05)
    if activity == "sit":
        sway = _shaped(random, count, rate_hz, lambda f: 1 / (1 + (f / 0.5) ** 4))
        acceleration[:, 0] += 0.3 * sway / max(sway.std(), 1e-9)
    if steps_hz:
        size = 2.0 if activity == "walk" else 7.0
        phase = 2 * np.pi * steps_hz * t + 0.15 * np.sin(2 * np.pi * 0.2 * t)
        acceleration[:, 2] += size * (np.sin(phase) + 0.35 * np.sin(2 * phase + 0.5))
        acceleration[:, 0] += 0.4 * size * np.sin(phase / 2)
        acceleration[:, 1] += 0.5 * size * np.sin(phase + 1.0)
    return acceleration, steps_hz * duration_s


def breathing_wave(
    duration_s: float, rate_hz: float, per_minute: float, seed: int, noise: float = 0.1
) -> Floats:
    """Return the wave of a breathing belt: its rate and depth vary by 5 %, with drift and noise."""
    random = np.random.default_rng(seed)
    count = round(duration_s * rate_hz)
    t = np.arange(count) / rate_hz
    slow = _shaped(random, count, rate_hz, lambda f: 1 / (1 + (f / 0.02) ** 4))
    slow = slow / max(slow.std(), 1e-12)
    phase = 2 * np.pi * np.cumsum(per_minute / 60 * (1 + 0.03 * slow - 0.03 * slow.mean())) / rate_hz
    depth = 1 + 0.1 * np.roll(slow, count // 3)
    wave = depth * (np.sin(phase) + 0.2 * np.sin(2 * phase + 0.7)) + 0.3 * slow * np.sin(t / 90)
    return np.asarray(wave + noise * random.normal(size=count), np.float64)


def ppg_of(
    beats: list[TrueBeat], duration_s: float, rate_hz: float, breathing_per_minute: float = 15.0
) -> Floats:
    """Return a PPG of `beats`: a systolic and a dicrotic wave after each, on a baseline that breathes."""
    t = np.arange(round(duration_s * rate_hz)) / rate_hz
    ppg = 0.15 * np.sin(2 * np.pi * t * breathing_per_minute / 60)
    for beat in beats:
        first, last = (int((beat.at_s + offset_s) * rate_hz) for offset_s in (-0.1, 1.0))
        near = t[max(0, first) : last] - beat.at_s
        for amplitude, offset_s, width_s in ((1.0, 0.22, 0.07), (0.4, 0.45, 0.09)):
            ppg[max(0, first) : last] += amplitude * np.exp(-0.5 * ((near - offset_s) / width_s) ** 2)
    return ppg


FaultName = Literal[
    "gap", "jump", "saturated", "clipped", "flat", "off", "quiet", "rate", "rateOfOldest", "unit", "nan"
]
FAULTS: Final[tuple[FaultName, ...]] = (
    "gap", "jump", "saturated", "clipped", "flat", "off", "quiet", "rate", "rateOfOldest", "unit", "nan",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Faulty:
    """Packets with a fault, the time it begins, and when each packet can be sent: its samples have passed."""

    packets: list[Samples]
    begin_s: float
    sent_s: list[float]


def with_fault(packets: list[Samples], name: FaultName, index: int, seed: int) -> Faulty:
    """Return packets of a fast signal with a fault from the packet `index` on.

    `off`: the strap is off and the sensor reports lost contact; `quiet`: it is off and reports nothing.
    `rate`: packets are stamped with the time of their newest sample, as by a Polar H10, so the first one
    shows the wrong rate; `rateOfOldest`: with that of their oldest sample, so the second one does.
    """
    random = np.random.default_rng(seed)
    delivered = list(packets)
    info = packets[0].info
    begin_s = packets[index].start_s
    period_s = 1 / (info.rate_hz or 1.0)
    sent_s = [packet.end_s + period_s for packet in packets]
    if name == "gap":
        lost = int(random.integers(1, 6))
        del delivered[index : index + lost], sent_s[index : index + lost]
        return Faulty(delivered, begin_s, sent_s)
    step_s = float(random.choice([-1, 1]) * random.uniform(0.1, 50))
    factor = (
        float(random.choice([0.001, 1000.0]))
        if info.kind is SignalKind.ECG
        else 9.80665 ** float(random.choice([-1, 1]))
    )
    ratio = float(random.choice([random.uniform(0.5, 0.9), random.uniform(1.1, 2.0)]))
    for number in range(index, len(packets)):
        packet = packets[number]
        values, start_s, has_contact = packet.values, packet.start_s, packet.has_contact
        if name == "jump":
            start_s += step_s
        elif name == "saturated":
            values = np.full_like(values, info.max_value)
        elif name == "clipped":
            bound = np.quantile(np.abs(values - np.median(values, axis=0)), 0.8)
            values = np.clip(values - np.median(values, axis=0), -bound, bound)
        elif name == "flat":
            values = np.repeat(packets[index].values[:1], len(values), axis=0)
        elif name in {"off", "quiet"}:
            values = values.mean(axis=0) + random.normal(size=values.shape) * 0.004 * (np.ptp(values) or 1.0)
            has_contact = False if name == "off" else has_contact
        elif name in {"rate", "rateOfOldest"}:
            stamped_s = packet.end_s if name == "rate" else start_s
            start_s += (stamped_s - begin_s) * (ratio - 1)
            sent_s[number] = begin_s + (sent_s[number] - begin_s) * ratio
        elif name == "unit":
            values = values * factor
        else:
            values = values.copy()
            values[int(random.integers(len(values)))] = np.nan
        delivered[number] = replace(packet, values=values, start_s=start_s, has_contact=has_contact)
    return Faulty(delivered, begin_s, sent_s)


def packets_of(
    info: SignalInfo,
    values: Floats,
    source: str,
    start_s: float,
    packet: int,
    *,
    has_contact: bool | None = None,
) -> list[Samples]:
    """Return a signal (samples, channels) in packets of `packet` samples, as a device sends them."""
    rate_hz = info.rate_hz or 1.0
    return [
        Samples(
            source,
            info,
            start_s + first / rate_hz,
            values[first : first + packet],
            clock=ClockKind.DEVICE,
            uncertainty_s=0.001,
            has_contact=has_contact,
        )
        for first in range(0, len(values) - packet + 1, packet)
    ]
