"""Body signals: beats, rates, faults, cost, memory; neurokit2, wfdb's xqrs and heartpy in the same run.

    HANDOVER_PHYSIOLOGY=folder python -m benchmarks.body.human_state [--quick] [--only beats rates ...]

Record 100 has annotations; the others have a second lead or another signal as reference. Noise is seeded, of
equal power of muscle, baseline and electrode between 0.5 and 40 Hz. A beat counts within 150 ms (EC57).
Costs are CPU times of the thread, and the load of the machine is printed beside them.
"""

import argparse
import copy
import gc
import os
import time
import tracemalloc
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import heartpy as heartpy_library
import neurokit2
import numpy as np
import wfdb
import wfdb.processing
from numpy.typing import NDArray

from benchmarks.body.wrapped_records import unwrapped
from benchmarks.steal_time import report_steal_time
from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.runner import WATCH_S
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo, SignalKind
from handover_body.processing.beats import BeatDetector
from handover_body.processing.breathing import breathing_of
from handover_body.processing.pipeline import pipeline_for
from handover_body.processing.pulse import pulse_of
from handover_body.processing.synthesis import (
    FAULTS,
    acceleration_of,
    add_ecg_noise,
    breathing_wave,
    ecg_of,
    packets_of,
    ppg_of,
    synthetic_beats,
    with_fault,
)

Floats = NDArray[np.float64]

RECORDS = Path(os.environ.get("HANDOVER_PHYSIOLOGY", Path(__file__).parents[3] / "shared/data/physiology"))
TOLERANCE_S = 0.15
BEGIN_S = 1_700_000_000.0
PACKET = 73
BEAT_SYMBOLS = frozenset("NLRBAaJSVrFejnE/fQ?")


# --- beats


def ours(ecg: Floats, rate_hz: float) -> Floats:
    """Return the R peaks in s, found in packets as a strap sends them."""
    detector = BeatDetector(rate_hz)
    size = round(0.56 * rate_hz)
    beats = [beat for first in range(0, len(ecg), size) for beat in detector.feed(ecg[first : first + size])]
    return np.array([beat.position for beat in beats + detector.flush()]) / rate_hz


def neurokit(ecg: Floats, rate_hz: float) -> Floats:
    """Return the R peaks of neurokit2's own method, which sees the whole signal."""
    _, info = neurokit2.ecg_peaks(neurokit2.ecg_clean(ecg, int(rate_hz)), int(rate_hz))
    return np.asarray(info["ECG_R_Peaks"], float) / rate_hz


def xqrs(ecg: Floats, rate_hz: float) -> Floats:
    """Return the R peaks of wfdb's xqrs."""
    return np.asarray(wfdb.processing.xqrs_detect(ecg, fs=rate_hz, verbose=False), float) / rate_hz


def heartpy(ecg: Floats, rate_hz: float) -> Floats:
    """Return the R peaks of heartpy, filtered as its documentation says for ECG."""
    filtered = heartpy_library.filter_signal(ecg, cutoff=[3, 40], sample_rate=rate_hz, filtertype="bandpass")
    working, _ = heartpy_library.process(np.asarray(filtered), rate_hz, bpmmin=30, bpmmax=220)
    kept = np.array(working["binary_peaklist"], bool)
    return np.asarray(working["peaklist"], float)[kept] / rate_hz


DETECTORS: dict[str, Callable[[Floats, float], Floats]] = {
    "ours, streaming": ours,
    "neurokit2": neurokit,
    "wfdb xqrs": xqrs,
    "heartpy": heartpy,
}


def matched(truth: Floats, estimates: Floats, tolerance_s: float = TOLERANCE_S) -> tuple[float, float, float]:
    """Return sensitivity and precision in percent, and the standard deviation of the times in ms."""
    errors = []
    first = second = 0
    while first < len(truth) and second < len(estimates):
        error = estimates[second] - truth[first]
        if abs(error) <= tolerance_s:
            errors.append(error)
        first += error >= -tolerance_s
        second += error <= tolerance_s
    deviation = float(np.std(errors)) if errors else float("nan")
    return (
        100 * len(errors) / max(1, len(truth)),
        100 * len(errors) / max(1, len(estimates)),
        1000 * deviation,
    )


def print_beats(title: str, ecg: Floats, rate_hz: float, truth: Floats) -> None:
    """Print one table of all detectors."""
    print(f"\n{title}: {len(truth)} beats, {rate_hz:g} Hz")
    for name, detect in DETECTORS.items():
        began = time.thread_time()
        try:
            beats = detect(ecg, rate_hz)
        except Exception as error:  # noqa: BLE001 -- a peer gives up on noise in its own way
            print(f"  {name:16} gives up: {type(error).__name__}: {str(error).splitlines()[0][:70]}")
            continue
        sensitivity, precision, deviation_ms = matched(truth, beats)
        print(
            f"  {name:16} sensitivity {sensitivity:6.2f} %  precision {precision:6.2f} %  "
            f"timing SD {deviation_ms:5.2f} ms  CPU {time.thread_time() - began:5.1f} s"
        )


def record(name: str) -> tuple[dict[str, Floats], float]:
    """Return the signals of a record by name, and its rate.

    v102s is stored in 12 bits and wraps around: its slow signals are unwrapped from sample to sample, its
    leads by `wrapped_records`.
    """
    stored = wfdb.rdrecord(str(RECORDS / name))
    signals = {key: np.nan_to_num(stored.p_signal[:, n]) for n, key in enumerate(stored.sig_name)}
    if name == "v102s":
        counts = wfdb.rdrecord(str(RECORDS / name), physical=False).d_signal.astype(float)
        for key in ("PLETH", "RESP"):
            signals[key] = np.unwrap(counts[:, stored.sig_name.index(key)], period=4096)
        for key in ("II", "V"):
            signals[key] = unwrapped(counts[:, stored.sig_name.index(key)], 4096)
    return signals, float(stored.fs)


def measure_beats(*, is_quick: bool) -> None:
    """Print sensitivity and precision on record 100, on synthetic people, and the agreement of leads."""
    print("R peaks (aims: 99.9 % and 99.9 %, SD 1.5 ms; at -6 dB 99.5 %; a synthetic person 99.5 %)")
    signals, rate_hz = record("100")
    notes = wfdb.rdann(str(RECORDS / "100"), "atr")
    truth = np.array(
        [at for at, symbol in zip(notes.sample, notes.symbol, strict=True) if symbol in BEAT_SYMBOLS]
    )
    print_beats("record 100", signals["MLII"], rate_hz, truth / rate_hz)
    for seed in (1,) if is_quick else (1, 2, 3):
        noisy = add_ecg_noise(signals["MLII"], rate_hz, -6, seed)
        print_beats(f"record 100 with noise at -6 dB, seed {seed}", noisy, rate_hz, truth / rate_hz)
    beats = synthetic_beats(1200, lambda at_s: 85 + 35 * np.sin(at_s / 90), 11, ectopic_share=0.04)
    ecg = ecg_of(beats, 1200, 130.0)
    times_s = np.array([beat.at_s for beat in beats])
    print_beats("synthetic person, 50 to 120 bpm, 4 % ectopic beats", ecg, 130.0, times_s)
    print_beats("the same with noise at -6 dB", add_ecg_noise(ecg, 130.0, -6, 5), 130.0, times_s)
    print("\nAgreement of two leads, in windows of 10 s in which both have quality 0.5 or more")
    for name in ("a103l", "v102s"):
        leads, rate_hz = record(name)
        first, two = (_beats_with_quality(leads[lead], rate_hz) for lead in ("II", "V"))
        kept, whole, agreeing, beats_in = 0, 0, 0, 0
        for begin_s in np.arange(0, len(leads["II"]) / rate_hz - 10, 10.0):
            inside = [lead[(lead[:, 0] >= begin_s) & (lead[:, 0] < begin_s + 10)] for lead in (first, two)]
            whole += 1
            if any(len(lead) < 3 or lead[:, 1].mean() < 0.5 for lead in inside):
                continue
            kept += 1
            beats_in += len(inside[0])
            agreeing += round(matched(inside[0][:, 0], two[:, 0])[0] * len(inside[0]) / 100)
        share = 100 * agreeing / beats_in if beats_in else float("nan")
        print(
            f"  {name}: {share:.2f} % of {beats_in} beats of lead II are in lead V; "
            f"{kept} of {whole} windows kept"
        )


def _beats_with_quality(ecg: Floats, rate_hz: float) -> Floats:
    detector = BeatDetector(rate_hz)
    beats = [beat for first in range(0, len(ecg), 140) for beat in detector.feed(ecg[first : first + 140])]
    return np.array([(beat.position / rate_hz, beat.quality) for beat in beats + detector.flush()])


BANDS = ((30, 60), (60, 90), (90, 120), (120, 150), (150, 180), (180, 200), (200, 220))


def measure_bands(*, is_quick: bool) -> None:
    """Print sensitivity and precision by heart rate, of synthetic people without and with noise."""
    print("\nR peaks by heart rate (aim: 99.5 % and 99.5 % in each band up to 220 bpm)")
    seconds = 60 if is_quick else 180
    for low, high in BANDS:
        shown = []
        for snr_db in (None, 6.0):
            results = []
            for seed, bpm in enumerate(np.linspace(low, high, 4)):
                beats = synthetic_beats(seconds, float(bpm), seed, rmssd_s=0.01)
                ecg = ecg_of(beats, seconds, 360.0)
                ecg = add_ecg_noise(ecg, 360.0, 30 if snr_db is None else snr_db, seed)
                results.append(matched(np.array([beat.at_s for beat in beats]), ours(ecg, 360.0), 0.08)[:2])
            sensitivity, precision = np.mean(results, axis=0)
            title = "clean" if snr_db is None else f"{snr_db:g} dB"
            shown.append(f"{title:5} sensitivity {sensitivity:6.2f} %  precision {precision:6.2f} %")
        print(f"  {low:3} to {high:3} bpm   " + "   ".join(shown))


# --- rates


def measure_rates() -> None:
    """Print errors of heart rate, pulse and breathing."""
    signals, rate_hz = record("100")
    notes = wfdb.rdann(str(RECORDS / "100"), "atr")
    truth = np.array(
        [at for at, symbol in zip(notes.sample, notes.symbol, strict=True) if symbol in BEAT_SYMBOLS]
    )
    print("\nHeart rate of the ECG of record 100, windows of 10 s (aim: mean error 0.3 bpm)")
    for name, detect in DETECTORS.items():
        errors = window_errors(truth / rate_hz, detect(signals["MLII"], rate_hz))
        print(f"  {name:16} mean error {np.mean(errors):.3f} bpm, p95 {np.percentile(errors, 95):.2f} bpm")
    print("Pulse of the PPG against the ECG, windows of 10 s (aim: 3 bpm where quality is 0.5 or more)")
    for name, lead in (("a103l", "II"), ("v102s", "V")):
        signals, rate_hz = record(name)
        beats = ours(signals[lead], rate_hz)
        ppg = signals["PLETH"].reshape(-1, 5).mean(axis=1)
        errors, qualities = [], []
        for first in range(0, len(ppg) - 500, 50):
            inside = beats[(beats >= first / 50) & (beats < first / 50 + 10)]
            if len(inside) >= 4:
                pulse, quality = pulse_of(ppg[first : first + 500], 50.0)
                errors.append(abs(pulse - 60 / float(np.mean(np.diff(inside)))))
                qualities.append(quality)
        kept = np.array(qualities) >= 0.5
        good = np.array(errors)[kept]
        print(
            f"  {name}: mean error {good.mean():.2f} bpm, largest {good.max():.2f}; "
            f"{100 * kept.mean():.0f} % of {len(kept)} windows kept; of all windows {np.mean(errors):.1f} bpm"
        )
    differences = []
    for seed, per_minute in enumerate((8, 10, 12, 15, 18, 22, 26, 30)):
        wave = breathing_wave(180, 25.0, per_minute, seed)
        differences += [
            abs(breathing_of(wave[at : at + 800], 25.0)[0] - per_minute) for at in range(0, 3600, 200)
        ]
    print(
        f"Breathing of simulated belts, 8 to 30 a minute: mean error "
        f"{np.mean(differences):.2f} a minute (aim: 1)"
    )
    signals, rate_hz = record("v102s")
    belt = signals["RESP"].reshape(-1, 25).mean(axis=1)
    info = SignalInfo(SignalKind.ECG, "C62", rate_hz)
    pipeline = pipeline_for(info)
    apart, of_good = [], []
    for packet in packets_of(info, signals["V"][:, None], "ecg", 0.0, 140):
        for feature in pipeline.feed(packet):
            end = int(feature.at_s * 10)
            if feature.name is FeatureName.BREATHING_RATE and end >= 320:
                rate, quality = breathing_of(belt[end - 320 : end], 10.0)
                if quality >= 0.5:
                    apart.append(abs(rate - float(feature.value)))
                    if feature.quality >= 0.3:
                        of_good.append(apart[-1])
    shown = (
        f"{np.mean(apart):.1f} a minute apart on {len(apart)} windows"
        if apart
        else "no window of quality 0.5"
    )
    best = f"; {np.mean(of_good):.1f} on the {len(of_good)} where the ECG has quality 0.3" if of_good else ""
    print(f"Breathing of v102s, chest wave and ECG: {shown}{best}")


def window_errors(truth: Floats, estimates: Floats) -> list[float]:
    """Return the error of the mean heart rate in each window of 10 s, in bpm."""
    errors = []
    for begin_s in np.arange(0, truth[-1] - 10, 10.0):
        inside = [beats[(beats >= begin_s) & (beats < begin_s + 10)] for beats in (truth, estimates)]
        if len(inside[0]) >= 3:
            rates = [60 / float(np.mean(np.diff(beats))) if len(beats) >= 3 else 0.0 for beats in inside]
            errors.append(abs(rates[0] - rates[1]))
    return errors


# --- faults


def measure_faults(count: int) -> None:
    """Print how soon seeded faults are found, and whether a wrong value passed as a good one."""
    print(
        f"\n{count} seeded faults of ECG and accelerometer (aim: found within 1 s, no false plausible value)"
    )
    ecg_info = SignalInfo(SignalKind.ECG, "D82", 130.0, min_value=-20_000, max_value=20_000)
    ecg = 1000 * ecg_of(synthetic_beats(34, 72, seed=3), 34, 130.0)
    ecg += np.random.default_rng(1).normal(0, 8, len(ecg))
    ecg_packets = packets_of(ecg_info, ecg[:, None], "ecg", BEGIN_S, PACKET)
    imu_info = SignalInfo(SignalKind.ACCELERATION, "MSK", 100.0, ("x", "y", "z"), -80, 80)
    cases: dict[str, tuple[Checks, list[Samples]]] = {"ecg": (Checks(ecg_info), ecg_packets)}
    for activity in ("rest", "sit", "walk", "run"):
        values = acceleration_of(activity, 24, 100.0, 4)[0]
        cases[activity] = Checks(imu_info), packets_of(imu_info, values, "imu", BEGIN_S, 36)
    warm = 36
    random = np.random.default_rng(5)
    for checks, packets in cases.values():
        for packet in packets[:warm]:
            checks.take(packet, packet.end_s + latency_s(random))
        assert not checks.faults
    names = [name for name in FAULTS if name != "quiet"]
    delays: dict[str, list[float]] = {}
    missed = wrong = 0
    for seed in range(count):
        case = ("ecg", "ecg", "rest", "sit", "walk", "run")[seed % 6]
        choices = [*names, "quiet"] if case == "ecg" else [n for n in names if n != "clipped"]
        name = choices[seed // 6 % len(choices)]
        delay_s, false_values = run_fault(copy.deepcopy(cases[case][0]), cases[case][1], name, warm, seed)
        wrong += false_values
        missed += delay_s is None
        if delay_s is not None:
            delays.setdefault(name, []).append(delay_s)
    late = {name: sum(delay > 1.0 for delay in fault_delays) for name, fault_delays in delays.items()}
    shown = ", ".join(f"{count} {name}" for name, count in late.items() if count) or "0"
    print(f"  not found {missed}, found later than 1 s {shown}, false plausible values {wrong}")
    for name, waits in delays.items():
        print(
            f"  {name:12} {len(waits):4} found, median {np.median(waits):.2f} s, longest {max(waits):.2f} s"
        )


class Checks:
    """What the service does with a signal: the monitor, then the pipeline."""

    def __init__(self, info: SignalInfo) -> None:
        self.pipeline = pipeline_for(info)
        # ROS topics may say only when a packet began; the others state the time of the newest sample
        self.monitor = SignalMonitor("sensor", info, stamps_oldest=True)
        self.faults: list[SensorFault | None] = []

    def take(self, packet: Samples, arrival_s: float) -> list[Feature]:
        """Take a packet at its arrival."""
        checked = self.monitor.take(packet, arrival_s)
        features = self.reported(checked.reports)
        return features if checked.samples is None else features + list(self.pipeline.feed(checked.samples))

    def look(self, now_s: float) -> list[Feature]:
        """Look for silence, as the runner does ten times a second."""
        silence = self.monitor.silence(now_s)
        return [] if silence is None else self.reported((silence,))

    def reported(self, reports: Sequence[SensorReport]) -> list[Feature]:
        """Take reports of the monitor."""
        self.faults += [report.fault for report in reports]
        return [feature for report in reports for feature in self.pipeline.report(report)]


def latency_s(random: np.random.Generator) -> float:
    """Return how long a packet takes to arrive."""
    return float(random.uniform(0.005, 0.03))


def run_fault(
    checks: Checks, packets: list[Samples], name: str, warm: int, seed: int
) -> tuple[float | None, int]:
    """Return after how many s the fault was found, and how many valid heart rates were wrong by 8 bpm."""
    faulty = with_fault(packets, name, warm, seed)  # type: ignore[arg-type]
    random = np.random.default_rng(seed)
    found_s: float | None = None
    features: list[Feature] = []
    looked_s = faulty.begin_s - float(random.uniform(0, WATCH_S))
    for packet, sent_s in list(zip(faulty.packets, faulty.sent_s, strict=True))[warm : warm + 16]:
        arrival_s = sent_s + latency_s(random)
        events = [*np.arange(looked_s + WATCH_S, arrival_s, WATCH_S), arrival_s]
        for at_s in events:
            features += checks.take(packet, at_s) if at_s == arrival_s else checks.look(at_s)
            if checks.faults and found_s is None:
                found_s = at_s - faulty.begin_s
        looked_s = events[-2] if len(events) > 1 else looked_s
    wrong = sum(
        feature.name is FeatureName.HEART_RATE
        and feature.status is Status.VALID
        and feature.quality >= 0.5
        and abs(float(feature.value) - 72) > 8
        for feature in features
    )
    return found_s, wrong


def measure_slow_faults() -> None:
    """Print after how many periods the silence of slow sensors is found."""
    delays = []
    for period_s in (1.0, 3.0, 5.0):
        info = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
        monitor = SignalMonitor("radar", info)
        for number in range(6):
            at_s = BEGIN_S + number * period_s
            monitor.take(Samples("radar", info, at_s, np.array([[70.0]]), np.array([at_s])), at_s)
        now_s = at_s
        while monitor.silence(now_s) is None:
            now_s += 0.1
        delays.append((now_s - at_s) / period_s)
    print(
        "  silence of sensors with a value each 1, 3 and 5 s: found after "
        f"{', '.join(f'{x:.1f}' for x in delays)} periods"
    )


# --- cost


def measure_cost(*, people: int, seconds: float) -> None:
    """Print the cores that many people need, and the time from a packet to its features."""
    kinds = {
        "ECG 130 Hz": (SignalInfo(SignalKind.ECG, "2Z", 130.0), PACKET),
        "accelerometer 50 Hz": (
            SignalInfo(SignalKind.ACCELERATION, "MSK", 50.0, ("x", "y", "z"), method="chest"),
            25,
        ),
        "PPG 100 Hz": (SignalInfo(SignalKind.PPG, "C62", 100.0, ("red", "ir")), 50),
        "belt 25 Hz": (SignalInfo(SignalKind.RESPIRATION, "C62", 25.0), 12),
        "EDA 10 Hz": (SignalInfo(SignalKind.EDA, "D80", 10.0), 5),
    }
    print(
        f"\n{people} people, {seconds:g} s of signal (aim: below one core; "
        "50 ms from the packet to the feature)"
    )
    total = 0.0
    for title, (info, packet) in kinds.items():
        costs: list[float] = []
        completing: list[float] = []
        for person in range(people):
            checks = Checks(info)
            for samples in packets_of(info, signal_of(info, seconds, person), "s", BEGIN_S, packet):
                began = time.thread_time()
                features = checks.take(samples, samples.end_s)
                costs.append(time.thread_time() - began)
                if features:
                    completing.append(costs[-1])
        cores = sum(costs) / seconds
        total += cores
        p50, p99 = (1000 * np.percentile(completing, share) for share in (50, 99))
        print(
            f"  {title:20} {cores:.3f} cores; a packet {1000 * np.mean(costs):.2f} ms; "
            f"to its feature p50 {p50:.2f} ms, p99 {p99:.2f} ms"
        )
    print(f"  all together {total:.3f} cores")


def signal_of(info: SignalInfo, seconds: float, person: int) -> Floats:
    """Return a signal (samples, channels) of one synthetic person."""
    rate_hz = info.rate_hz or 1.0
    random = np.random.default_rng(person)
    beats = synthetic_beats(seconds, 60 + person % 60, person, ectopic_share=0.01)
    count = round(seconds * rate_hz)
    if info.kind is SignalKind.ECG:
        return add_ecg_noise(ecg_of(beats, seconds, rate_hz), rate_hz, 6, person)[:, None]
    if info.kind is SignalKind.PPG:
        ppg = 5000 + 50 * ppg_of(beats, seconds, rate_hz)[:, None] * np.array([[1, 2]])
        return ppg + random.normal(0, 0.5, ppg.shape)
    if info.kind is SignalKind.ACCELERATION:
        return acceleration_of(("rest", "sit", "walk", "run")[person % 4], seconds, rate_hz, person)[0]
    if info.kind is SignalKind.RESPIRATION:
        return breathing_wave(seconds, rate_hz, 10 + person % 15, person)[:, None]
    return (4 + 0.3 * np.sin(np.arange(count) / rate_hz / 9) + 0.01 * random.random(count))[:, None]


def measure_memory() -> None:
    """Print the memory of an ECG pipeline over an hour of signal, replayed as fast as it can be."""
    info = SignalInfo(SignalKind.ECG, "2Z", 130.0)
    checks = Checks(info)
    ten_minutes = ecg_of(synthetic_beats(600, 72, 1), 600, 130.0)[:, None]
    ten_minutes = ten_minutes + np.random.default_rng(1).normal(0, 0.01, ten_minutes.shape)
    block = len(ten_minutes) // PACKET * PACKET
    tracemalloc.start()
    kept = []
    began, cpu = time.perf_counter(), time.thread_time()
    for part in range(6):
        for packet in packets_of(info, ten_minutes[:block], "s", BEGIN_S + part * block / 130, PACKET):
            checks.take(packet, packet.end_s)
        gc.collect()
        kept.append(tracemalloc.get_traced_memory()[0] / 1e6)
    tracemalloc.stop()
    shown = ", ".join(f"{value:.2f}" for value in kept)
    print(
        f"\nMemory of an ECG after 10, 20 ... 60 minutes of signal: {shown} MB "
        f"({time.perf_counter() - began:.0f} s, {time.thread_time() - cpu:.0f} s CPU, with tracing)"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="one seed, 120 faults, 10 people")
    parser.add_argument(
        "--only", nargs="+", default=[], help="beats, bands, rates, faults, silence, cost, memory"
    )
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; records in {RECORDS}")
    parts: dict[str, Callable[[], None]] = {
        "beats": partial(measure_beats, is_quick=options.quick),
        "bands": partial(measure_bands, is_quick=options.quick),
        "rates": measure_rates,
        "faults": partial(measure_faults, 120 if options.quick else 1000),
        "silence": measure_slow_faults,
        "cost": partial(measure_cost, people=10 if options.quick else 50, seconds=60),
        "memory": measure_memory,
    }
    if not (RECORDS / "100.dat").is_file():
        print("no records; HANDOVER_PHYSIOLOGY names their folder. Only synthetic signals are measured")
        del parts["beats"], parts["rates"]
    with report_steal_time():
        for name, part in parts.items():
            if not options.only or name in options.only:
                part()
    print(f"load average at the end {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
