"""The simulated person and sensor: the same seed gives the same signals, and each fault is found."""

import asyncio
import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from handover_body.drivers.runner import SensorRunner
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.drivers.simulated.person import SimulatedPerson
from handover_body.drivers.simulated.waveforms import EVENTS, WAVES
from handover_body.model.cardiovascular import Physiology
from handover_body.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalKind,
)

START_S = 1_700_000_000.0
TEXTS = {SignalKind.POSTURE, SignalKind.ACTIVITY, SignalKind.SLEEP}


async def simulate(**settings: object) -> tuple[list[Samples], list[SensorReport], SimulatedDriver]:
    given = {"pace": 0, "duration_s": 30, "start_s": START_S, **settings}
    driver = SimulatedDriver("person", SimulatedSettings.model_validate(given))
    items: list[Samples | SensorReport] = []
    runner = SensorRunner(driver, items.append)
    await runner.run()
    return (
        [item for item in items if isinstance(item, Samples)],
        [item for item in items if isinstance(item, SensorReport)],
        driver,
    )


def rate_after(person: SimulatedPerson, seconds: float) -> float:
    person.advance(seconds)
    return person.heart_rate_bpm


def test_the_heart_follows_effort_in_its_time() -> None:
    person = SimulatedPerson(1, rest_bpm=60, max_bpm=180)
    assert rate_after(person, 60) == pytest.approx(60, abs=1)
    person.effort = 0.5
    rises = rate_after(person, 57.5)
    assert 60 + 0.5 * 60 < rises < 60 + 0.7 * 60, "the sum of the time constants"
    assert 120 < rate_after(person, 1000) < 126, "with the drift of long work"
    person.effort = 0.0
    recovers = rate_after(person, 54.4)
    assert 80 < recovers < 100
    assert rate_after(person, 1000) == pytest.approx(60, abs=3)


def test_a_walk_sets_effort_and_gait() -> None:
    person = SimulatedPerson(1, body=Physiology.of_age(55))
    person.walk(1.3)
    assert person.effort == person.body.walking_effort(1.3) > 0.2
    assert rate_after(person, 300) == pytest.approx(104, abs=3)
    person.walk(0.0)
    assert rate_after(person, 600) == pytest.approx(70, abs=3)


def test_beats_agree_with_the_rate_and_memory_is_bounded() -> None:
    person = SimulatedPerson(2, rest_bpm=70)
    person.advance(600)
    assert person.beat_count == pytest.approx(700, rel=0.02)
    assert len(person.beats_s) < 40
    assert np.all(np.diff(person.beats_s) > 0.3)


def test_an_apnoea_slows_the_heart_and_breath_returns_with_a_rise() -> None:
    person = SimulatedPerson(3, rest_bpm=60)
    person.advance(60)
    person.is_breathing = False
    slow = rate_after(person, 25)
    person.is_breathing = True
    fast = rate_after(person, 3)
    assert slow < 53
    assert fast > 63


def test_a_heart_that_no_person_has_is_refused() -> None:
    with pytest.raises(ValueError, match="rest below maximum"):
        SimulatedPerson(rest_bpm=120, max_bpm=100)


async def test_every_signal_is_simulated_at_its_rate_within_its_range() -> None:
    samples, reports, driver = await simulate(signals=list(WAVES), duration_s=30)
    assert not [report for report in reports if report.fault]
    for info in driver.signals:
        mine = [one for one in samples if one.info.kind is info.kind]
        values = np.concatenate([one.values for one in mine])
        assert len(values) == math.ceil(30 * (info.rate_hz or 0) - 1e-6), info.kind
        known = values[np.isfinite(values)]
        assert known.size > 0.5 * values.size, info.kind
        assert known.min() >= info.min_value
        assert known.max() <= info.max_value
        assert all(one.quality == np.isfinite(one.values).all() for one in mine)
        assert all(one.clock is ClockKind.RECORDING for one in mine)


def test_every_signal_that_is_a_number_has_a_simulator() -> None:
    assert WAVES.keys() | EVENTS.keys() == set(SignalKind) - TEXTS


async def test_every_event_is_simulated_within_its_range_and_in_order() -> None:
    program = [{"at_s": 1, "effort": 0.3, "posture": "standing"}]
    samples, reports, driver = await simulate(signals=list(EVENTS), duration_s=130, program=program)
    assert not [report for report in reports if report.fault]
    for info in driver.signals:
        mine = [one for one in samples if one.info.kind is info.kind]
        values = np.concatenate([one.values for one in mine])
        times_s = np.concatenate([one.sample_times_s() for one in mine])
        assert len(values) >= 2, info.kind
        assert np.isfinite(values).all()
        assert info.min_value <= values.min() <= values.max() <= info.max_value
        assert np.all(np.diff(times_s) > 0)


async def test_a_seed_repeats_its_signals() -> None:
    first, _, _ = await simulate(seed=7, duration_s=5)
    again, _, _ = await simulate(seed=7, duration_s=5)
    other, _, _ = await simulate(seed=8, duration_s=5)
    assert all(
        np.array_equal(one.values, two.values, equal_nan=True) for one, two in zip(first, again, strict=True)
    )
    assert not all(
        np.array_equal(one.values, two.values, equal_nan=True) for one, two in zip(first, other, strict=True)
    )


async def test_neurokit_finds_the_beats_of_the_simulated_ecg() -> None:
    import neurokit2

    beats: set[float] = set()
    driver = SimulatedDriver(
        "person",
        SimulatedSettings(
            signals=(SignalKind.ECG,), rates_hz={SignalKind.ECG: 250}, pace=0, duration_s=60, start_s=0.0
        ),
    )
    chunks: list[np.ndarray] = []

    def sink(item: Samples | SensorReport) -> None:
        beats.update(beat for beat in driver.person.beats_s if beat < 60)
        if isinstance(item, Samples):
            chunks.append(item.values[:, 0])

    await driver.run(sink)
    cleaned = neurokit2.ecg_clean(np.concatenate(chunks), sampling_rate=250)
    found = neurokit2.ecg_peaks(cleaned, sampling_rate=250)[1]["ECG_R_Peaks"] / 250
    inner = [beat for beat in sorted(beats) if 1 < beat < 59]
    assert len(inner) > 50
    assert all(np.abs(found - beat).min() < 0.03 for beat in inner)
    assert abs(len(found) - len(beats)) <= 2


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        ("gap", SensorFault.GAP),
        ("clockJump", SensorFault.GAP),  # forward, in a recording: it looks like a gap
        ("strapOff", SensorFault.NO_CONTACT),
        ("silentStrapOff", SensorFault.FLAT),
        ("saturated", SensorFault.SATURATED),
        ("flat", SensorFault.FLAT),
        ("reconnect", SensorFault.RECONNECTED),
        ("unit", SensorFault.UNIT),
    ],
)
async def test_each_fault_is_found_by_the_runner(fault: str, found: SensorFault) -> None:
    size = {"unit": 1e-6, "clockJump": 5.0}.get(fault, 2.0)
    faults = [{"kind": fault, "at_s": 10, "duration_s": 6, "size": size}]
    samples, reports, _ = await simulate(signals=["ecg"], faults=faults)
    assert found in {report.fault for report in reports}
    assert all(one.quality == 1.0 for one in samples if one.end_s < START_S + 10)


async def test_a_simulated_rate_that_lies_is_found() -> None:
    faults = [{"kind": "rate", "at_s": 5, "duration_s": 10, "size": 0.7}]
    _, reports, _ = await simulate(signals=["ecg"], faults=faults)
    assert {SensorFault.GAP, SensorFault.RATE} & {report.fault for report in reports}


async def test_a_lost_connection_is_simulated_and_the_samples_resume() -> None:
    samples, reports, _ = await simulate(faults=[{"kind": "reconnect", "at_s": 5, "duration_s": 4}])
    assert [report.link for report in reports if report.link].count(LinkState.LOST) == 2  # and the end
    assert samples[-1].end_s > START_S + 29


async def test_at_its_pace_the_device_stamps_and_the_times_are_ours() -> None:
    before_s = asyncio.get_running_loop().time()
    samples, reports, _ = await simulate(pace=1, duration_s=1.0, signals=["ecg"], start_s=None)
    assert asyncio.get_running_loop().time() - before_s >= 0.95
    assert {one.clock for one in samples} == {ClockKind.DEVICE}
    assert all(report.at_s - 5 < samples[-1].end_s for report in reports)
    assert all(one.uncertainty_s > 0 for one in samples)


def test_a_signal_that_cannot_be_simulated_is_refused_with_those_that_can() -> None:
    with pytest.raises(ValidationError, match="choose from ecg"):
        SimulatedSettings(signals=(SignalKind.POSTURE,))


async def test_a_simulated_person_acts_while_the_sensor_runs() -> None:
    driver = SimulatedDriver("person", SimulatedSettings(signals=(SignalKind.PRESSURE_MAP,)))
    driver.simulate({"effort": 0.4, "lean": [0.0, 1.0], "isBreathing": False, "movement": 30})
    person = driver.person
    assert (person.effort, person.lean, person.is_breathing, person.movement) == (0.4, (0.0, 1.0), False, 30)
    driver.simulate({"lean": [0.5, 0.0]})
    assert (person.effort, person.lean) == (0.4, (0.5, 0.0)), "what is absent stays"


@pytest.mark.parametrize(
    "given", [{"effort": 2}, {"lean": [0]}, {"height": 1}, {"posture": "supine"}, [], "{}", None]
)
async def test_acts_that_cannot_be_are_refused(given: object) -> None:
    driver = SimulatedDriver("person", SimulatedSettings())
    with pytest.raises(ValidationError):
        driver.simulate(given)
    assert driver.person.effort == 0.0


async def test_a_strap_that_slips_off_has_no_contact() -> None:
    driver = SimulatedDriver("person", SimulatedSettings(pace=0, start_s=START_S))
    driver.simulate({"contact": False})
    off = {one.info.kind: one.has_contact for one in driver.next_packets()}
    assert off[SignalKind.ECG] is False
    assert off[SignalKind.ACCELERATION] is None
    driver.simulate({"contact": True})
    assert all(one.has_contact is not False for one in driver.next_packets())


@pytest.mark.parametrize("given", [{"effort": "0.4"}, {"contact": 0}, {"walkingMps": True}], ids=str)
def test_acts_follow_the_types_of_json(given: dict[str, Any]) -> None:
    driver = SimulatedDriver("person", SimulatedSettings())
    with pytest.raises(ValidationError, match="valid"):
        driver.simulate(given)
