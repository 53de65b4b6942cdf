"""Circulation, gait and mood of a simulated person agree with heart and walk, and each fault is found."""

import numpy as np
import pytest

from handover_body.drivers.runner import SensorRunner
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.drivers.simulated.person import SimulatedPerson
from handover_body.model.cardiovascular import cadence_hz, speed_mps_of_cadence
from handover_body.model.signals import GAIT_CHANNELS, Samples, SensorFault, SensorReport, SignalKind

START_S = 1_700_000_000.0
WALK = [{"at_s": 0.5, "effort": 0.2, "posture": "standing"}]
FAST = (
    SignalKind.ICG,
    SignalKind.BCG,
    SignalKind.JOINT_ANGLES,
    SignalKind.JOINT_MOMENTS,
    SignalKind.ANGULAR_VELOCITY,
    SignalKind.MAGNETIC_FIELD,
)
SLOW = (SignalKind.STROKE_VOLUME, SignalKind.CARDIAC_OUTPUT, SignalKind.DISTANCE)
FOUND = {
    "gap": {SensorFault.GAP},
    "clockJump": {SensorFault.GAP},  # forward, in a recording: it looks like a gap
    "strapOff": {SensorFault.NO_CONTACT},
    "reconnect": {SensorFault.RECONNECTED},
    "saturated": {SensorFault.SATURATED},
    "flat": {SensorFault.FLAT},
    "rate": {SensorFault.GAP, SensorFault.RATE},
}
OF_WAVES = {"saturated", "flat", "rate"}
"""A single value may stay as it is, and be the highest one."""


async def simulate(**settings: object) -> tuple[list[Samples], list[SensorReport], SimulatedPerson]:
    given = {"pace": 0, "start_s": START_S, **settings}
    driver = SimulatedDriver("person", SimulatedSettings.model_validate(given))
    items: list[Samples | SensorReport] = []
    await SensorRunner(driver, items.append).run()
    return (
        [item for item in items if isinstance(item, Samples)],
        [item for item in items if isinstance(item, SensorReport)],
        driver.person,
    )


async def signal_of(kind: SignalKind, **settings: object) -> tuple[np.ndarray, np.ndarray, SimulatedPerson]:
    """Return times from the start and values of a minute, after four minutes of the same effort."""
    samples, _, person = await simulate(signals=[kind], duration_s=300, packet_s=2.0, **settings)
    late = [one for one in samples if one.start_s >= START_S + 240]
    times_s = np.concatenate([one.sample_times_s() for one in late]) - START_S
    return times_s, np.concatenate([one.values for one in late]), person


@pytest.mark.parametrize(
    ("kind", "fault"),
    [(kind, fault) for kind in (*FAST, *SLOW) for fault in FOUND if kind in FAST or fault not in OF_WAVES],
)
async def test_faults_of_every_signal_are_found(kind: SignalKind, fault: str) -> None:
    size = 0.7 if fault == "rate" else 12.0
    faults = [{"kind": fault, "at_s": 20, "duration_s": 12, "size": size}]
    samples, reports, _ = await simulate(signals=[kind], faults=faults, duration_s=60)
    assert FOUND[fault] & {report.fault for report in reports}
    assert all(one.quality == 1.0 for one in samples if one.end_s < START_S + 20)
    assert fault == "rate" or samples[-1].quality == 1.0, "it is good again"


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        ("strapOff", SensorFault.NO_CONTACT),
        ("artefact", SensorFault.UNIT),
        ("unit", SensorFault.UNIT),
        ("reconnect", SensorFault.RECONNECTED),
    ],
)
async def test_faults_of_beats_are_found(fault: str, found: SensorFault) -> None:
    faults = [{"kind": fault, "at_s": 20, "duration_s": 20, "size": 0.001}]
    samples, reports, _ = await simulate(signals=["interBeatInterval"], faults=faults, duration_s=60)
    assert found in {report.fault for report in reports}
    good = np.concatenate([one.values for one in samples if one.quality > 0])
    assert ((good > 240) & (good < 2400)).all()


@pytest.mark.parametrize(("effort", "volume_ml"), [(0.0, 75), (0.4, 110)])
async def test_the_equation_of_kubicek_gives_back_the_stroke_volume(effort: float, volume_ml: float) -> None:
    program = [{"at_s": 0.5, "effort": effort}]
    times_s, ohm, person = await signal_of(SignalKind.ICG, program=program)
    _, intervals_ms, _ = await signal_of(SignalKind.INTER_BEAT_INTERVAL, program=program)
    window = np.hanning(13) / np.hanning(13).sum()
    change = -np.gradient(np.convolve(ohm[:, 0], window, "same"), times_s)[20:-20]
    beat_s = float(np.mean(intervals_ms)) / 1000
    highest = float(np.median([part.max() for part in np.array_split(change, round(60 / beat_s))]))
    ml = 135 * (30 / 25) ** 2 * 0.30 * np.sqrt(beat_s) * highest
    assert person.stroke_volume_ml == pytest.approx(volume_ml, abs=3)
    assert ml == pytest.approx(person.stroke_volume_ml, rel=0.2)


async def test_a_recoil_follows_each_beat_and_the_output_is_volume_times_rate() -> None:
    times_s, newton, person = await signal_of(SignalKind.BCG)
    beats_s, _, _ = await signal_of(SignalKind.INTER_BEAT_INTERVAL)
    delays_s = []
    for beat in beats_s[(beats_s > 241) & (beats_s < 299)]:
        near = (times_s > beat + 0.1) & (times_s < beat + 0.4)
        delays_s.append(times_s[near][newton[near, 0].argmax()] - beat)
    assert np.median(delays_s) == pytest.approx(0.22, abs=0.02)
    _, litres, person = await signal_of(SignalKind.CARDIAC_OUTPUT)
    assert np.mean(litres) == pytest.approx(person.stroke_volume_ml * person.heart_rate_bpm / 1000, rel=0.05)
    _, rmssd, _ = await signal_of(SignalKind.HEART_RATE_VARIABILITY)
    assert 5 < np.nanmedian(rmssd) < 120


async def test_joints_strides_and_steps_are_of_one_gait() -> None:
    _, degrees, person = await signal_of(SignalKind.JOINT_ANGLES, program=WALK)
    strides_s, gait, _ = await signal_of(SignalKind.GAIT, program=WALK)
    steps_s, steps, _ = await signal_of(SignalKind.STEPS, program=WALK)
    steps_hz = person.steps_hz
    assert np.ptp(steps) / np.ptp(steps_s) == pytest.approx(steps_hz, rel=0.02)
    assert len(strides_s) == pytest.approx(60 * steps_hz / 2, abs=2)
    row = dict(zip(GAIT_CHANNELS, np.median(gait, axis=0), strict=True))
    assert row["cadence_per_min"] == pytest.approx(60 * steps_hz, rel=0.01)
    assert row["step_length_m"] == pytest.approx(row["speed_mps"] / steps_hz, rel=0.01)
    assert row["double_support_fraction"] == pytest.approx(2 * row["stance_fraction"] - 1)
    knee, other = degrees[:, 1], degrees[:, 4]
    assert 45 < knee.max() < 80
    swings = np.flatnonzero(np.diff((knee > 35).astype(int)) == 1)
    assert len(swings) == pytest.approx(len(strides_s), abs=3)
    later = round(100 / steps_hz)
    assert np.corrcoef(knee[:-later], other[later:])[0, 1] > 0.95, "the other leg is half a stride later"
    _, moments, _ = await signal_of(SignalKind.JOINT_MOMENTS, program=WALK)
    assert 60 < moments[:, 2].max() < 170
    _, turning, _ = await signal_of(SignalKind.ANGULAR_VELOCITY, program=WALK)
    assert 2 < np.abs(turning[:, 1]).max() < 12


async def test_who_sits_has_no_gait_and_that_is_no_fault() -> None:
    samples, reports, _ = await simulate(signals=["gait", "jointAngles"], duration_s=60)
    assert not [one for one in samples if one.info.kind is SignalKind.GAIT]
    assert not [report for report in reports if report.fault]
    assert np.mean([one.values[:, 1].mean() for one in samples]) == pytest.approx(90, abs=1)


async def test_effort_excites_and_is_unpleasant_near_the_maximum() -> None:
    moods = {}
    for effort in (0.0, 0.5, 1.0):
        _, values, _ = await signal_of(SignalKind.MOOD, program=[{"at_s": 0.5, "effort": effort}])
        moods[effort] = values[-1]
    assert moods[0.0][0] == moods[0.5][0] > 0 > moods[1.0][0]
    assert moods[0.0][1] < moods[0.5][1] < moods[1.0][1] <= 1


@pytest.mark.parametrize("speed_mps", [0.3, 1.3, 2.0])
def test_a_cadence_belongs_to_one_speed(speed_mps: float) -> None:
    assert speed_mps_of_cadence(cadence_hz(speed_mps)) == pytest.approx(speed_mps)
    person = SimulatedPerson(1)
    person.walk(speed_mps)
    assert person.gait_mps == pytest.approx(speed_mps)
