"""What is known of a simulated person comes from the signals, on a clock of its own."""

import pytest

from handover_body.cases.sensed_person import SensedPerson
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.drivers.simulated.person import SimulatedPerson
from handover_body.limits.curve import LimitCurve
from handover_body.model.cardiovascular import Physiology
from handover_body.model.features import FeatureName, Status


def sensed(seed: int = 1, *, age: float = 55, **settings: object) -> SensedPerson:
    given = {"signals": ["ecg", "acceleration"], "pace": 0, "start_s": 0.0, "seed": seed, **settings}
    body = SimulatedPerson(seed, body=Physiology.of_age(age))
    driver = SimulatedDriver("strap", SimulatedSettings.model_validate(given), body)
    return SensedPerson(driver, LimitCurve())


def live(person: SensedPerson, seconds: float) -> SensedPerson:
    for _ in range(round(seconds / 0.25)):
        person.step()
    return person


@pytest.mark.nightly
def test_the_heart_rate_and_the_steps_of_a_walk_are_found_in_the_signals() -> None:
    person = live(sensed(), 20)
    assert person.heart_rate is not None
    assert float(person.heart_rate.value) == pytest.approx(70, abs=4)
    person.body.walk(1.2)
    live(person, 150)
    found = person.heart_rate
    assert found is not None
    assert float(found.value) == pytest.approx(person.body.heart_rate_bpm, abs=3)
    assert float(found.value) > 85
    cadence = person.value(FeatureName.CADENCE)
    assert cadence is not None
    assert float(cadence.value) == pytest.approx(105, abs=8), "steps a minute at 1.2 m/s"
    assert person.limit.fraction < 1.0


def test_steps_are_counted_while_the_pace_changes_all_the_time() -> None:
    person = live(sensed(), 5)
    for number in range(4 * 40):
        person.body.walk(0.8 + 0.1 * (number % 7) / 7)
        person.step()
    steps = person.value(FeatureName.STEPS)
    assert steps is not None
    assert steps.status is Status.VALID
    assert float(steps.value) == pytest.approx(40 * 90 / 60, rel=0.15), "some 90 steps a minute"


def test_a_seed_repeats_a_run() -> None:
    first, again, other = (live(sensed(seed), 30).heart_rate for seed in (4, 4, 5))
    assert first == again
    assert first != other


def test_a_strap_that_comes_off_ends_the_heart_rate_and_then_the_limit() -> None:
    person = live(sensed(faults=[{"kind": "silentStrapOff", "at_s": 40, "duration_s": 600}]), 38)
    assert person.heart_rate is not None
    before = person.limit.fraction
    live(person, 6)
    assert person.heart_rate is None
    value = person.value(FeatureName.HEART_RATE)
    assert value is not None
    assert value.status is not Status.VALID
    live(person, 12)
    assert before > 0
    assert person.limit.is_stopped
