"""A finger that is not to be relied on is named, with what is wrong and what to do."""

import random
from collections.abc import Sequence

import pytest

from services.gesture_controller.calibration.doubts import doubts_about, lasting_doubts
from services.gesture_controller.calibration.levels import calibrate

FIST, OPEN = [300.0, 500, 500, 500, 450], [400.0, 700, 700, 690, 680]


def shown(levels: Sequence[float], noise: Sequence[float] = (2,) * 5) -> list[list[float]]:
    chance = random.Random(7)
    return [[chance.gauss(level, by) for level, by in zip(levels, noise, strict=True)] for _ in range(50)]


def with_ring(levels: Sequence[float], ring: float) -> list[float]:
    return [*levels[:3], ring, levels[4]]


def told(fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]) -> list[tuple[str, str]]:
    return [(doubt.finger, doubt.why.value) for doubt in doubts_about(fist, open_hand)]


def test_a_hand_that_fits_raises_no_doubt() -> None:
    assert told(shown(FIST), shown(OPEN)) == []
    assert lasting_doubts(calibrate(shown(FIST), shown(OPEN))) == []


def test_a_small_span_is_doubtful_in_whichever_finger() -> None:
    assert told(shown(FIST), shown(with_ring(OPEN, 540))) == [("ring", "smallSpan")]
    assert told(shown(FIST), shown([320, *OPEN[1:]])) == [("thumb", "smallSpan")]


def test_a_noisy_finger_is_doubtful() -> None:
    assert told(shown(FIST, (2, 2, 2, 30, 2)), shown(OPEN)) == [("ring", "noisy")]


def test_a_dead_sensor_and_one_at_its_stop_are_told_apart() -> None:
    for value, why in ((317.0, "dead"), (0.0, "saturated"), (1023.0, "saturated")):
        fist, open_hand = shown(FIST), shown(OPEN)
        for frame in (*fist, *open_hand):
            frame[3] = value
        assert told(fist, open_hand) == [("ring", why)]


def test_a_sensor_that_is_at_its_stop_in_the_open_hand_alone_is_saturated() -> None:
    open_hand = shown(OPEN)
    for frame in open_hand:
        frame[2] = 1023.0
    assert told(shown(FIST), open_hand) == [("middle", "saturated")]


def test_a_sensor_the_wrong_way_round_is_told() -> None:
    assert told(shown(FIST), shown(with_ring(OPEN, 310))) == [("ring", "wrongWay")]


@pytest.mark.parametrize("ring", [310.0, 540.0])
def test_each_doubt_says_what_to_do(ring: float) -> None:
    (doubt,) = doubts_about(shown(FIST), shown(with_ring(OPEN, ring)))
    assert doubt.as_dict()["finger"] == "ring"
    assert len(doubt.as_dict()["advice"]) > 40
