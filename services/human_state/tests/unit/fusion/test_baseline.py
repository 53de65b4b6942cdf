"""Personal baselines, by age and measured."""

import pytest

from handover_body.fusion.baseline import (
    Baseline,
    NoBaseline,
    by_age,
    measured_maximum_bpm,
    measured_rest_bpm,
)
from handover_body.model.features import Feature, FeatureName, Status


def beats(bpm: float, from_s: int, to_s: int, status: Status = Status.VALID) -> list[Feature]:
    return [Feature(FeatureName.HEART_RATE, "strap", bpm, at, 0.9, status) for at in range(from_s, to_s)]


def test_the_maximum_by_age_follows_tanaka() -> None:
    assert by_age(40).maximum_bpm == pytest.approx(180)
    assert by_age(40).exertion(125) == pytest.approx(0.5)


@pytest.mark.parametrize("age", [3, 150, float("nan")])
def test_an_age_that_no_worker_has_is_refused(age: float) -> None:
    with pytest.raises(NoBaseline, match="give the heart rates"):
        by_age(age)


def test_rest_and_maximum_must_be_apart() -> None:
    with pytest.raises(NoBaseline, match="measure again"):
        Baseline(100, 110)


def test_rest_is_the_lowest_mean_of_a_minute() -> None:
    values = [*beats(75, 0, 120), *beats(62, 120, 200), *beats(70, 200, 300)]
    assert measured_rest_bpm(values) == pytest.approx(62)


def test_rest_needs_enough_valid_values() -> None:
    with pytest.raises(NoBaseline, match="sit still"):
        measured_rest_bpm(beats(62, 0, 100))
    with pytest.raises(NoBaseline):
        measured_rest_bpm(beats(62, 0, 300, Status.IMPLAUSIBLE))
    with pytest.raises(NoBaseline):
        measured_rest_bpm(beats(62, 0, 300)[::2])


def test_the_maximum_is_the_highest_mean_of_ten_seconds() -> None:
    values = [*beats(120, 0, 30), *beats(171, 30, 45), *beats(190, 45, 47), *beats(150, 47, 60)]
    assert measured_maximum_bpm(values) == pytest.approx((8 * 171 + 2 * 190) / 10)
