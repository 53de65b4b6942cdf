"""Lines, rates and times of devices."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_devices.protocol.lines import LineBuffer
from handover_devices.protocol.messages import BadMessage
from handover_devices.protocol.rates import TokenBucket
from handover_devices.protocol.times import TimeRule


@given(st.lists(st.binary(max_size=12), max_size=12), st.lists(st.integers(0, 200), max_size=8))
def test_lines_do_not_depend_on_how_the_stream_is_divided(parts: list[bytes], cuts: list[int]) -> None:
    stream = b"\n".join(parts)
    whole, divided = LineBuffer(8), LineBuffer(8)
    places = sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})
    expected = whole.feed(stream)
    found = [line for begin, end in pairwise(places) for line in divided.feed(stream[begin:end])]
    assert found == expected
    assert divided.has_overflowed == whole.has_overflowed
    *complete, rest = stream.split(b"\n")
    assert whole.has_overflowed == any(len(line) > 8 for line in [*complete, rest])
    assert found == complete[: len(found)]


@given(
    st.lists(st.tuples(st.floats(0, 10), st.floats(0.5, 20)), min_size=1, max_size=60),
    st.floats(1, 50),
    st.floats(1, 50),
)
def test_no_more_than_the_rate_passes_a_sender_that_waits(
    sends: list[tuple[float, float]], rate: float, burst: float
) -> None:
    now_s, passed, largest = 0.0, 0.0, 0.0
    bucket = TokenBucket.full(rate, burst, now_s)
    for pause_s, units in sends:
        now_s += pause_s
        assert passed <= burst + rate * now_s + largest + 1e-6
        wait_s = bucket.spend(units, now_s)
        passed, largest = passed + units, max(largest, units)
        now_s += wait_s
    assert bucket.spend(0.0, now_s) <= 1e-6  # after the wait it may send again


def test_a_message_may_be_late_but_not_from_the_future() -> None:
    rule = TimeRule(max_age_s=3600, max_ahead_s=60)
    assert rule.time_of(None, 10_000.0) == 10_000.0
    assert rule.time_of(10_050.0, 10_000.0) == 10_050.0
    assert rule.time_of(6_500.0, 10_000.0) == 6_500.0
    for t, code in ((10_061.0, "future"), (1e13, "future"), (6_399.0, "tooOld"), (-1e308, "tooOld")):
        with pytest.raises(BadMessage) as caught:
            rule.time_of(t, 10_000.0, 5)
        assert (caught.value.code, caught.value.seq) == (code, 5)


@given(
    st.floats(-3600, 60),
    st.sampled_from([(1, ""), (1_000, "milli"), (1_000_000, "micro"), (1_000_000_000, "nano")]),
    st.floats(1.6e9, 4e9),
)
def test_a_time_in_a_smaller_unit_is_refused_with_the_unit_and_no_other_with_it(
    late_s: float, unit: tuple[int, str], now_s: float
) -> None:
    factor, name = unit
    rule = TimeRule(max_age_s=3600, max_ahead_s=60)
    if factor == 1:
        assert rule.time_of(now_s + late_s / 2, now_s) == now_s + late_s / 2
    else:
        with pytest.raises(BadMessage, match=f"divide it by {factor}: t is in seconds, and .* {name}seconds"):
            rule.time_of((now_s + late_s / 2) * factor, now_s)
    for t in ((now_s + 1e6) * factor, 5.0):
        with pytest.raises(BadMessage, match=r"set the clock of the device [(]NTP[)], or leave t out$"):
            rule.time_of(t, now_s)
