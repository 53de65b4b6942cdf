"""A short sample becomes a code, or it is said which finger moved or is undecided."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.people.sample import UnclearSample, read_sample
from handover_gloves.recognition.thresholds import Threshold, Thresholds

THRESHOLDS = Thresholds((Threshold(600, 400),) * 5)
RAW = {"0": 700.0, "1": 500.0, "2": 300.0}


def frames(code: str, count: int = 50) -> list[list[float]]:
    return [[RAW[state] for state in code]] * count


@given(st.text("02", min_size=5, max_size=5), st.randoms(use_true_random=False))
def test_the_code_seen_most_often_is_taken(code: str, chance: object) -> None:
    shown = frames(code, 45) + frames("11111", 5)
    chance.shuffle(shown)  # type: ignore[attr-defined] - a random.Random
    read, sample = read_sample("glove-1", shown, THRESHOLDS)
    assert read == code
    assert sample.levels == tuple(RAW[state] for state in code)


def test_noise_is_measured_from_frame_to_frame() -> None:
    shown = [[300.0 + step / 10 + (10 if step % 2 else 0)] * 5 for step in range(50)]
    _, sample = read_sample("glove-1", shown, THRESHOLDS)
    assert sample.noise[0] == pytest.approx(1.4826 * 10 / 2**0.5, rel=0.02)


def test_the_error_for_a_moving_hand_names_the_finger() -> None:
    with pytest.raises(
        UnclearSample, match=r"the hand moved: index and ring changed, .* only 60 % of"
    ) as unclear:
        read_sample("glove-1", frames("20202", 30) + frames("22222", 20), THRESHOLDS)
    assert "keeps still" in str(unclear.value)


def test_a_finger_that_is_neither_bent_nor_straight_is_named() -> None:
    with pytest.raises(
        UnclearSample, match=r"the ring is neither bent nor straight \(500, between 400 and 600\)"
    ):
        read_sample("glove-1", frames("20212"), THRESHOLDS)


@pytest.mark.parametrize(
    ("shown", "words"), [(frames("20202", 9), "9 frames are too few"), ([[1.0] * 4] * 20, "not five values")]
)
def test_what_is_no_sample_is_refused(shown: list[list[float]], words: str) -> None:
    with pytest.raises(UnclearSample, match=words):
        read_sample("glove-1", shown, THRESHOLDS)
