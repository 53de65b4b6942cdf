"""The monitor of one person: features of sensors, and those that follow from all of them."""

import time
from dataclasses import replace

import numpy as np

from handover.messages import Message
from handover_body.checks.monitor import SignalMonitor
from handover_body.model.features import FeatureName, Status
from handover_body.model.signals import (
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.monitoring.processors import pipeline_of
from handover_body.people.consent import Consent
from handover_body.people.people import Person
from handover_body.processing.adl.classifier import AdlClassifier
from handover_body.storage.store import ConsentRow, LimitRow, PersonRow, SensorRow

YEAR_US = int(365 * 86400e6)
WRIST = SignalInfo(SignalKind.ACCELERATION, "MSK", 50.0, ("x", "y", "z"), method="wrist")
SEAT = SignalInfo(SignalKind.PRESSURE_MAP, "C62", 10.0, tuple(f"r{i // 4}c{i % 4}" for i in range(12)))
BLINK = SignalInfo(SignalKind.BLINK, "SEC", None, ("duration_s",))
RATE = SignalInfo(SignalKind.HEART_RATE, "BPM", None, method="chest strap")


def person(*purposes: str) -> Person:
    now_us = int(time.time() * 1e6)
    return Person(
        PersonRow("aino", "p-1", 60.0, 180.0, "given", now_us),
        LimitRow("aino", 90.0, 125.0, 0.2, is_stopped=False),
        Consent(ConsentRow("aino", frozenset(purposes), now_us - 1, now_us + YEAR_US, "aino")),
        {"strap": SensorRow("strap", "heart-rate-strap", {}, "aino")},
    )


def feed(monitor: PersonMonitor, bpm: float, seconds: int) -> None:
    now_s = time.time()
    for second in range(seconds):
        at_s = now_s - seconds + second + 1
        monitor.take(Samples("strap", RATE, at_s, np.array([[bpm]]), np.array([at_s])))


def test_stress_and_fatigue_follow_from_the_heart_rate_and_feed_no_limit() -> None:
    monitor = PersonMonitor(person("live"), pipeline_of)
    feed(monitor, 150.0, 60)
    values = {value.name: value for value in monitor.values(time.monotonic())}
    assert values[FeatureName.HEART_RATE].value == 150.0
    assert float(values[FeatureName.FATIGUE].value) > 0
    assert values[FeatureName.STRESS].value == 1.0
    assert values[FeatureName.STRESS].status is Status.VALID
    assert not values[FeatureName.STRESS].is_calibrated
    assert monitor.state.for_limits(FeatureName.STRESS, time.monotonic()) is None


def test_a_changed_baseline_changes_what_is_strain() -> None:
    monitor = PersonMonitor(person("live"), pipeline_of)
    trained = person("live")
    row = PersonRow("aino", "p-1", 100.0, 200.0, "given", 0)
    monitor.change(Person(row, trained.limit, trained.consent, trained.sensors))
    feed(monitor, 104.0, 60)
    values = {value.name: value for value in monitor.values(time.monotonic())}
    assert float(values[FeatureName.STRESS].value) == 0.1


class Model:
    """Predicts rest, whatever it gets."""

    classes_ = ("Rest", "Transfer")

    def predict_proba(self, figures: np.ndarray) -> np.ndarray:
        return np.array([[0.9, 0.1]])


def test_an_activity_needs_wrist_and_seat_together_and_ends_with_a_fault() -> None:
    made: list[AdlClassifier] = []

    def classifier() -> AdlClassifier:
        made.append(AdlClassifier(Model(), "analysis"))
        return made[-1]

    sensors = {name: SensorRow(name, "simulated", {}, "aino") for name in ("wrist", "seat")}
    aino = person("live")
    aino = Person(aino.row, aino.limit, aino.consent, sensors)
    monitor = PersonMonitor(aino, pipeline_of, classifier)
    now_s = time.time() - 20
    for half in range(40):
        at_s = now_s + half / 2
        monitor.take(Samples("wrist", WRIST, at_s, np.tile([0.0, 0.0, 9.81], (25, 1)) + half % 3))
        if half == 10:
            assert not made
        if half >= 10:
            monitor.take(Samples("seat", SEAT, at_s, np.full((5, 12), 100.0 + half % 2)))
    assert len(made) == 1
    values = {value.name: value for value in monitor.values(time.monotonic())}
    assert values[FeatureName.DAILY_ACTIVITY].value == "Rest"
    assert not values[FeatureName.DAILY_ACTIVITY].is_calibrated


def test_without_consent_nothing_is_kept() -> None:
    monitor = PersonMonitor(person(), pipeline_of)
    feed(monitor, 150.0, 60)
    assert monitor.values(time.monotonic()) == []
    assert not monitor.recent


def test_a_signal_of_which_nothing_is_computed_is_shown_with_the_reason() -> None:
    """Also after news of the link, which replace what was said about it."""
    monitor = PersonMonitor(person("live"), pipeline_of)
    slow = SignalInfo(SignalKind.ECG, "D82", 11.0, method="lead II")
    monitor.take(Samples("strap", slow, time.time(), np.zeros((5, 1))))
    monitor.take(SensorReport("strap", time.time(), link=LinkState.CONNECTED))
    (reason,) = monitor.sensors["strap"].left_out.values()
    assert isinstance(reason, Message)
    assert reason.code == "health.signal.not_analysed"
    assert "50 to 2,000 Hz; this one has 11 Hz" in reason


def test_a_contact_that_is_back_is_shown() -> None:
    monitor, checks, now_s = (
        PersonMonitor(person("live"), pipeline_of),
        SignalMonitor("strap", RATE),
        time.time(),
    )
    shown = []
    for second, has_contact in enumerate((True, False, True)):
        at_s = now_s - 3 + second
        worn = Samples("strap", RATE, at_s, np.array([[70.0]]), np.array([at_s]), has_contact=has_contact)
        checked = checks.take(worn, at_s)
        for item in (*checked.reports, checked.samples):
            if item is not None:
                monitor.take(item)
        shown.append(monitor.sensors["strap"].has_contact)
    assert shown == [True, False, True]


def test_that_nothing_happened_is_news_for_the_analysis_only() -> None:
    glasses = {"glasses": SensorRow("glasses", "simulated", {}, "aino")}
    monitor = PersonMonitor(replace(person("live"), sensors=glasses), pipeline_of)
    tapped: list[object] = []
    monitor.taps.add(tapped.append)
    waiting = monitor.listen()
    now_s = time.time()
    for second in range(62):
        monitor.take(Samples("glasses", BLINK, now_s - 61 + second, np.empty((0, 1)), np.empty(0)))
    assert not waiting
    assert not [one for one in tapped if isinstance(one, Samples)]
    assert monitor.sensors["glasses"].signals == {}
    (rate,) = [each for each in monitor.values(time.monotonic()) if each.name is FeatureName.BLINK_RATE]
    assert (rate.value, rate.status) == (0.0, Status.VALID)


def test_two_sensors_40_bpm_apart_limit_by_the_higher_rate_and_say_so() -> None:
    both = replace(person("live", "speedLimits"), sensors={
        "strap": SensorRow("strap", "heart-rate-strap", {}, "aino"),
        "radar": SensorRow("radar", "seeed-radar", {}, "aino"),
    })  # fmt: skip
    monitor, now_s = PersonMonitor(both, pipeline_of), time.time()
    for second in range(8):
        at_s = now_s - 8 + second
        for source, bpm in (("strap", 80.0), ("radar", 120.0)):
            info = replace(RATE, method=source)
            monitor.take(Samples(source, info, at_s, np.array([[bpm]]), np.array([at_s])))
    (rate,) = [each for each in monitor.values(time.monotonic()) if each.name is FeatureName.HEART_RATE]
    assert (rate.value, rate.disagree) == (120.0, True)
    monitor.step(time.monotonic())
    assert monitor.limit.fraction <= 0.2 + 0.8 * (125 - 120) / (125 - 90)


def test_a_person_without_sensors_has_no_values_and_stops_the_robot() -> None:
    monitor = PersonMonitor(replace(person("live", "speedLimits"), sensors={}), pipeline_of)
    began_s = time.monotonic()
    feed(monitor, 70.0, 20)  # of a sensor that is not of this person
    assert monitor.values(began_s) == []
    for second in range(1, 12):
        monitor.step(began_s + second)
        assert monitor.limit.fraction <= 0.25
    assert monitor.limit.fraction == 0.0


def test_a_gap_of_the_gaze_ends_the_blink_rate_of_the_same_glasses() -> None:
    blink = SignalInfo(SignalKind.BLINK, "SEC", None, ("duration_s",))
    sensors = {name: SensorRow(name, "simulated", {}, "aino") for name in ("glasses", "others")}
    aino = person("live")
    monitor = PersonMonitor(Person(aino.row, aino.limit, aino.consent, sensors), pipeline_of)
    begin_s = time.time() - 60
    for number in range(16):
        at_s = begin_s + 4 * number
        for source in sensors:
            monitor.take(Samples(source, blink, at_s, np.array([[0.2]]), np.array([at_s])))

    def status(source: str) -> Status:
        found = monitor.state.sensors(FeatureName.BLINK_RATE, time.monotonic())
        return next(one.status for one in found if one.source == source)

    assert (status("glasses"), status("others")) == (Status.VALID, Status.VALID)
    monitor.take(SensorReport("glasses", time.time(), fault=SensorFault.ARTEFACT, kind=SignalKind.GAZE))
    assert status("glasses") is Status.VALID, "an artefact of the gaze is none of the blinks"
    monitor.take(SensorReport("glasses", time.time(), fault=SensorFault.GAP, kind=SignalKind.GAZE))
    assert (status("glasses"), status("others")) == (Status.STALE, Status.VALID)


def test_whether_a_sensor_is_worn_is_a_value_of_the_person() -> None:
    monitor = PersonMonitor(person("live"), pipeline_of)

    def worn() -> tuple[object, Status] | None:
        values = {one.name: one for one in monitor.values(time.monotonic())}
        found = values.get(FeatureName.WEAR_STATE)
        return None if found is None else (found.value, found.status)

    feed(monitor, 70.0, 3)
    assert worn() is None, "this strap does not measure it"
    now_s = time.time()
    touching = Samples("strap", RATE, now_s, np.array([[70.0]]), np.array([now_s]), has_contact=True)
    monitor.take(touching)
    assert worn() == ("worn", Status.VALID)
    monitor.take(SensorReport("strap", now_s, fault=SensorFault.NO_CONTACT, has_contact=False))
    assert worn() == ("notWorn", Status.VALID)
    monitor.sensors["strap"].contact_at_s -= 60
    assert worn() == ("notWorn", Status.STALE)
