"""The wizard waits for a late person, captures a still second, and survives any input."""

import random
from collections.abc import Iterator, Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.simulation.hand import AT_REST, FIST, OPEN_HAND, Posture, SimulatedHand
from handover_gloves.calibration.calibration_wizard import (
    CAPTURE_S,
    MAX_CAPTURE_S,
    MAX_UNCHANGED_S,
    SAMPLE_STEPS,
    CalibrationWizard,
    Step,
    WizardPhase,
)
from handover_gloves.calibration.sensor_diagnostics import find_sensor_faults
from handover_gloves.recognition.levels import calibrate

Shown = tuple[Posture, float]


def frames(shown: Sequence[Shown], hz: float, seed: int = 3) -> Iterator[tuple[Sequence[float], float]]:
    """Yield what a hand measures that makes each posture for some seconds, and when."""
    hand = SimulatedHand(seed, rate_hz=hz, posture=shown[0][0])
    number = 0
    for posture, seconds in shown:
        hand.move(posture, 0.4)
        for _ in range(round(seconds * hz)):
            number += 1
            yield hand.read(), number / hz


def run_wizard(
    shown: Sequence[Shown], hz: float = 50, wizard: CalibrationWizard | None = None, seed: int = 3
) -> list[CalibrationWizard]:
    made = [wizard or CalibrationWizard()]
    for bend, at_s in frames(shown, hz, seed):
        made.append(made[-1].after(bend, at_s))
        if made[-1].is_over:
            break
    return made


@pytest.mark.parametrize("hz", [20, 50, 100, 200])
def test_a_fist_and_an_open_hand_take_eight_seconds_at_any_rate(hz: float) -> None:
    made = run_wizard([(AT_REST, 1), (FIST, 4), (OPEN_HAND, 10)], hz)
    done = next(wizard for wizard in made if wizard.is_over)
    assert done.phase is WizardPhase.DONE
    assert done.at_s < 10
    fist, open_hand = done.hand()
    for captured in (fist, open_hand):
        assert len(captured) == pytest.approx(CAPTURE_S * hz, abs=2)
    assert not find_sensor_faults(fist, open_hand)
    assert calibrate(fist, open_hand).levels[1].span > 150


@given(st.floats(0, 9), st.floats(0, 9), st.sampled_from([20, 50]), st.integers(0, 1000))
def test_who_is_late_is_waited_for(before_s: float, between_s: float, hz: float, seed: int) -> None:
    """The hand rests, or stays a fist, too long; a fist and an open hand are captured all the same."""
    made = run_wizard([(OPEN_HAND, before_s), (FIST, 4.5 + between_s), (OPEN_HAND, 12)], hz, seed=seed)
    done = made[-1]
    assert done.phase is WizardPhase.DONE
    levels = calibrate(*done.hand()).levels
    assert all(level.span > 40 for level in levels)


def test_who_shows_them_the_other_way_round_is_understood() -> None:
    done = run_wizard([(OPEN_HAND, 4.5), (FIST, 10)])[-1]
    assert done.phase is WizardPhase.DONE
    assert all(level.span > 0 for level in calibrate(*done.hand()).levels)


def test_a_restless_finger_is_named_and_waited_for() -> None:
    fidgeting = [(FIST, 0.5), ((0.0, 0.6, 0.0, 0.0, 0.0), 0.5)] * 8
    made = run_wizard([*fidgeting, (FIST, 6)])
    named = [wizard.restless for wizard in made if wizard.restless]
    assert all("index" in fingers for fingers in named[5:20])
    assert made[-1].captured
    assert next(wizard for wizard in made if wizard.captured).at_s > 8


def test_a_glove_without_any_working_sensor_comes_to_an_end() -> None:
    wizard, at_s = CalibrationWizard(), 0.0
    while not wizard.is_over:
        at_s += 0.02
        wizard = wizard.after([512.0] * 5, at_s)
    assert wizard.phase is WizardPhase.DONE
    assert at_s < 3 + CAPTURE_S + 3 + MAX_UNCHANGED_S + 2
    assert {fault.kind.value for fault in find_sensor_faults(*wizard.hand())} == {"dead"}


def test_a_hand_that_is_never_still_is_given_up() -> None:
    chance, wizard, at_s = random.Random(1), CalibrationWizard(), 0.0
    levels = [400.0] * 5
    while not wizard.is_over:
        at_s += 0.05
        if round(at_s * 20) % 6 == 0:
            levels = [chance.uniform(300, 700) for _ in range(5)]
        wizard = wizard.after(levels, at_s)
    assert wizard.phase is WizardPhase.GIVEN_UP
    assert at_s == pytest.approx(3 + MAX_CAPTURE_S, abs=1)


def test_a_gap_begins_the_second_again() -> None:
    made = run_wizard([(FIST, 3.7)])
    assert made[-1].phase is WizardPhase.CAPTURE
    after = made[-1].after(list(FIST), made[-1].at_s + 5)
    assert not after.window
    assert after.remaining_s == pytest.approx(CAPTURE_S)


def test_a_sample_takes_one_step() -> None:
    victory: Posture = (0.0, 1.0, 1.0, 0.0, 0.0)
    made = run_wizard([(victory, 6)], wizard=CalibrationWizard(SAMPLE_STEPS, countdown_s=1))
    assert made[-1].phase is WizardPhase.DONE
    assert made[-1].step is Step.GESTURE
    assert len(made[-1].captured) == 1


@given(
    st.lists(
        st.tuples(
            st.lists(st.floats(-1e6, 1e6), min_size=5, max_size=5), st.floats(-0.5, 3, allow_nan=False)
        ),
        max_size=120,
    )
)
def test_whatever_comes_it_only_goes_forward(given_: list[tuple[list[float], float]]) -> None:
    wizard, at_s, made = CalibrationWizard(countdown_s=0.2), 100.0, []
    for bend, passed_s in given_:
        at_s += passed_s
        wizard = wizard.after(bend, at_s)
        made.append(wizard)
    for before, now in pairwise(made):
        assert len(now.captured) >= len(before.captured)
        assert not (before.is_over and now != before)
        assert now.remaining_s <= max(CAPTURE_S, 0.2) + 1e-9
