"""Drift is followed slowly and never turns a held gesture into another; a jump asks for a calibration."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_gloves.calibration.fitting import calibration_from, learnt_from
from handover_gloves.calibration.samples import sample_of, with_sample
from handover_gloves.recognition.drift import MAX_DRIFT, MAX_RATE_PER_S
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.levels import MAX_INVERTED, calibrate
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.thresholds import Threshold, Thresholds

FIST, OPEN = (300.0, 500, 500, 500, 450), (400.0, 700, 700, 690, 680)
SPANS = tuple(high - low for low, high in zip(FIST, OPEN, strict=True))
GESTURES = Gestures({**M2O2P_GESTURES, "Four fingers": "20000", "Fist": "22222", "Open hand": "00000"})
CALIBRATION = calibrate([FIST] * 50, [OPEN] * 50)
BOTH = ("thresholds", "personal")


def config(recognizer: str, thresholds: Thresholds | None = None) -> RecognitionConfig:
    return RecognitionConfig(
        thresholds or CALIBRATION.thresholds, GESTURES, calibration=CALIBRATION, recognizer_name=recognizer
    )


def raw(shares: tuple[float, ...]) -> list[float]:
    return [low + share * span for low, share, span in zip(FIST, shares, SPANS, strict=True)]


def keep(
    shares: tuple[float, ...],
    seconds: float,
    with_: RecognitionConfig,
    before: PipelineState | None = None,
    hz: float = 10,
) -> list[PipelineState]:
    """Keep the fingers where they are for a while."""
    seen = [before or PipelineState()]
    from_s = seen[0].recognition.at_s if seen[0].recognition else 0.0
    bend = raw(shares)
    for number in range(round(seconds * hz)):
        seen.append(process_frame(seen[-1], Frame(from_s + (number + 1) / hz, bend), with_))
    return seen[1:]


hands = st.tuples(*[st.floats(-0.5, 1.5)] * 5)


@given(hands, st.sampled_from(BOTH))
def test_a_held_gesture_is_never_turned_by_following(shares: tuple[float, ...], recognizer: str) -> None:
    seen = keep(shares, 30, config(recognizer))
    settled = seen[10:]
    assert {one.gesture for one in settled} == {settled[0].gesture}


@given(hands, st.lists(st.tuples(st.floats(100, 400), st.floats(0, 300)), min_size=5, max_size=5))
def test_nor_with_thresholds_set_by_hand(shares: tuple[float, ...], bands: list[tuple[float, float]]) -> None:
    by_hand = Thresholds(
        tuple(
            Threshold(low + above + band, low + above) for low, (above, band) in zip(FIST, bands, strict=True)
        )
    )
    settled = keep(shares, 30, config("thresholds", by_hand))[10:]
    assert {one.gesture for one in settled} == {settled[0].gesture}


@given(hands, hands)
def test_nor_when_the_person_has_shown_it_in_a_way_of_their_own(
    shown: tuple[float, ...], near: tuple[float, ...]
) -> None:
    sample = sample_of("20222", [raw(shown)] * 50, CALIBRATION.levels)
    taught = RecognitionConfig(
        CALIBRATION.thresholds,
        GESTURES,
        calibration=with_sample(CALIBRATION, sample),
        recognizer_name="personal",
    )
    shares = tuple(one + 0.1 * (other - one) for one, other in zip(shown, near, strict=True))
    settled = keep(shares, 30, taught)[10:]
    assert {one.gesture for one in settled} == {settled[0].gesture}


@given(st.lists(hands, min_size=2, max_size=6), st.sampled_from(BOTH))
def test_levels_never_move_faster_or_further_than_they_may(
    shapes: list[tuple[float, ...]], recognizer: str
) -> None:
    seen: list[PipelineState] = [PipelineState()]
    for shares in shapes:
        for one in keep(shares, 5, config(recognizer), seen[-1]):
            for now, before, span in zip(one.drift.offsets, seen[-1].drift.offsets, SPANS, strict=True):
                assert abs(now - before) <= MAX_RATE_PER_S * span / 10 + 1e-6
                assert abs(now) <= MAX_DRIFT * span + 1e-6
            seen.append(one)


@settings(max_examples=20)
@given(
    st.lists(st.tuples(*[st.integers(-4, 12).map(lambda eighths: eighths / 8)] * 5), min_size=1, max_size=4),
    st.sets(st.integers(0, 4), min_size=1, max_size=MAX_INVERTED),
    st.sampled_from(BOTH),
)
def test_an_inverted_finger_is_recognized_and_followed_as_any_other(
    shapes: list[tuple[float, ...]], inverted: set[int], recognizer: str
) -> None:
    def turned(bend: Sequence[float]) -> list[float]:
        return [1024 - value if place in inverted else value for place, value in enumerate(bend)]

    made = calibrate([turned(FIST)] * 50, [turned(OPEN)] * 50)
    stored = Thresholds((Threshold(1, 0),) * 5).with_changes(made.thresholds.as_dict())
    assert [each.inverted for each in stored.fingers] == [place in inverted for place in range(5)]
    kept = calibration_from(learnt_from(made), stored)
    other = RecognitionConfig(stored, GESTURES, calibration=kept, recognizer_name=recognizer)
    assert other.missing is None
    plain = config(recognizer)
    one, two = PipelineState(), PipelineState()
    for number in range(40 * len(shapes)):
        bend = raw(shapes[number // 40])
        one = process_frame(one, Frame((number + 1) / 20, bend), plain)
        two = process_frame(two, Frame((number + 1) / 20, turned(bend)), other)
        assert (two.states, two.gesture) == (one.states, one.gesture)
        assert two.drift.wants_calibration == one.drift.wants_calibration
        assert list(map(abs, two.drift.offsets)) == pytest.approx(list(map(abs, one.drift.offsets)), abs=1e-6)


_CONFIGS = {recognizer: config(recognizer) for recognizer in BOTH}


@pytest.mark.parametrize("recognizer", BOTH)
def test_a_level_that_sinks_slowly_is_followed(recognizer: str) -> None:
    """The open hand and gestures in turn, while every level sinks by a fifth of its span in five minutes."""
    state, at_s, right, rounds = PipelineState(), 0.0, 0, 60
    for number in range(rounds):
        sunk = 0.2 * number / rounds
        for code in ("00000", "00222", "20022"):
            shares = tuple((1.0 if state == "0" else 0.1) - sunk for state in code)
            for _ in range(40):
                at_s += 0.05
                state = process_frame(state, Frame(at_s, raw(shares)), _CONFIGS[recognizer])
            right += state.gesture == GESTURES.names[code]
    assert right == 3 * rounds
    assert state.drift.wants_calibration is None
    assert all(
        offset < -0.03 * span for offset, span in zip(state.drift.offsets[1:3], SPANS[1:3], strict=True)
    )


def test_a_jump_that_stays_asks_for_a_calibration_and_stops_following() -> None:
    before = keep((1.0,) * 5, 1, _CONFIGS["thresholds"], hz=50)[-1]
    assert before.drift.wants_calibration is None
    after = keep((1.0, 1.0, 1.4, 1.0, 1.0), 1.1, _CONFIGS["thresholds"], before, hz=50)[-1]
    assert after.drift.wants_calibration == "the level of the middle jumped by 40% of its span"
    later = keep((1.3,) * 5, 10, _CONFIGS["thresholds"], after, hz=50)[-1]
    assert later.drift.offsets == after.drift.offsets
    assert later.drift.wants_calibration == after.drift.wants_calibration


def test_a_spark_is_no_jump() -> None:
    before = keep((1.0,) * 5, 1, _CONFIGS["thresholds"], hz=50)[-1]
    spark = keep((1.0, 1.0, 1.5, 1.0, 1.0), 0.06, _CONFIGS["thresholds"], before, hz=50)[-1]
    assert keep((1.0,) * 5, 3, _CONFIGS["thresholds"], spark, hz=50)[-1].drift.wants_calibration is None


def test_a_finger_that_moves_as_fast_as_fingers_can_is_no_jump() -> None:
    state, at_s = PipelineState(), 0.0
    for step in [0.0, 0.2, 0.5, 0.8, 1.0] * 20:
        at_s += 0.02
        state = process_frame(state, Frame(at_s, raw((step,) * 5)), _CONFIGS["personal"])
        at_s += 0.02
        state = process_frame(state, Frame(at_s, raw((step,) * 5)), _CONFIGS["personal"])
        at_s += 0.3  # a pause
    assert state.drift.wants_calibration is None


def test_a_sensor_that_comes_off_asks_for_a_calibration() -> None:
    state, at_s = PipelineState(), 0.0
    for number in range(100):
        at_s += 0.05
        state = process_frame(
            state, Frame(at_s, raw((1.0, 1.0, min(1 + number / 20, 3.0), 1.0, 1.0))), _CONFIGS["personal"]
        )
    assert state.drift.wants_calibration == (
        "the middle stands far outside what it showed from fist to open hand"
    )


def test_without_a_calibration_nothing_drifts() -> None:
    with_ = RecognitionConfig(CALIBRATION.thresholds, GESTURES)
    assert keep((1.4,) * 5, 20, with_)[-1].drift.offsets == (0.0,) * 5
