"""An unreliable sensor is reported with its fault and advice."""

import random
from collections.abc import Sequence

import pytest

from handover_gloves.calibration.sensor_diagnostics import find_lasting_faults, find_sensor_faults
from handover_gloves.recognition.levels import calibrate

FIST, OPEN = [300.0, 500, 500, 500, 450], [400.0, 700, 700, 690, 680]


def shown(levels: Sequence[float], noise: Sequence[float] = (2,) * 5) -> list[list[float]]:
    chance = random.Random(7)
    return [[chance.gauss(level, by) for level, by in zip(levels, noise, strict=True)] for _ in range(50)]


def with_ring(levels: Sequence[float], ring: float) -> list[float]:
    return [*levels[:3], ring, levels[4]]


def faults(fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]) -> list[tuple[str, str]]:
    return [(fault.finger, fault.kind.value) for fault in find_sensor_faults(fist, open_hand)]


def test_a_hand_that_fits_has_no_fault() -> None:
    assert faults(shown(FIST), shown(OPEN)) == []
    assert find_lasting_faults(calibrate(shown(FIST), shown(OPEN))) == []


def test_a_small_span_is_a_fault_of_any_finger() -> None:
    assert faults(shown(FIST), shown(with_ring(OPEN, 540))) == [("ring", "smallSpan")]
    assert faults(shown(FIST), shown([320, *OPEN[1:]])) == [("thumb", "smallSpan")]


def test_a_noisy_finger_is_a_fault() -> None:
    assert faults(shown(FIST, (2, 2, 2, 30, 2)), shown(OPEN)) == [("ring", "noisy")]


def test_a_dead_sensor_and_one_at_its_stop_are_distinguished() -> None:
    for value, why in ((317.0, "dead"), (0.0, "saturated"), (1023.0, "saturated")):
        fist, open_hand = shown(FIST), shown(OPEN)
        for frame in (*fist, *open_hand):
            frame[3] = value
        assert faults(fist, open_hand) == [("ring", why)]


def test_a_sensor_that_is_at_its_stop_in_the_open_hand_alone_is_saturated() -> None:
    open_hand = shown(OPEN)
    for frame in open_hand:
        frame[2] = 1023.0
    assert faults(shown(FIST), open_hand) == [("middle", "saturated")]


def test_sensors_the_wrong_way_round_are_reported_if_they_are_too_many_for_inverted_ones() -> None:
    assert faults(shown(FIST), shown(with_ring(OPEN, 310))) == []
    falling = [200.0, 300, 300, *OPEN[3:]]
    assert [why for _, why in faults(shown(FIST), shown(falling))] == ["wrongWay"] * 3


def test_an_inverted_sensor_is_judged_by_its_span_as_any_other() -> None:
    calibration = calibrate(shown(FIST), shown(with_ring(OPEN, 310)))
    assert calibration.thresholds.fingers[3].inverted
    assert find_lasting_faults(calibration) == []
    assert faults(shown(FIST, (2, 2, 2, 30, 2)), shown(with_ring(OPEN, 310))) == [("ring", "noisy")]


@pytest.mark.parametrize("ring", [480.0, 540.0])
def test_each_fault_has_advice(ring: float) -> None:
    (fault,) = find_sensor_faults(shown(FIST), shown(with_ring(OPEN, ring)))
    assert fault.as_dict()["finger"] == "ring"
    assert len(fault.as_dict()["advice"]) > 40
