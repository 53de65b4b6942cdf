"""The clock of a device is mapped to ours within the stated uncertainty."""

from hypothesis import given
from hypothesis import strategies as st

from handover_body.checks.timing import WINDOW_S, ClockMap

LATENCY_S = 0.1


@given(
    origin_s=st.floats(-1e9, 1e9),
    drift=st.floats(-100e-6, 100e-6),
    delays_s=st.lists(st.floats(0.0, 2.0), min_size=1, max_size=200),
    period_s=st.floats(0.05, 3.0),
)
def test_the_error_stays_within_the_uncertainty(
    origin_s: float, drift: float, delays_s: list[float], period_s: float
) -> None:
    clock = ClockMap(LATENCY_S)
    fast_s = float("-inf")
    arrived_s = float("-inf")
    for number, delay_s in enumerate(delays_s):
        sampled_s = 1000.0 + number * period_s
        device_s = origin_s + sampled_s * (1 + drift)
        arrival_s = max(arrived_s, sampled_s + delay_s)  # packets of one connection arrive in order
        arrived_s = arrival_s
        if arrival_s - sampled_s <= LATENCY_S:
            fast_s = arrival_s
        mapped_s = device_s + clock.observe(device_s, arrival_s)
        assert mapped_s <= arrival_s + 1e-6, "no sample is taken after it arrived"
        if arrival_s - fast_s <= WINDOW_S:
            assert abs(mapped_s - sampled_s) <= clock.uncertainty_s + 1e-6


def test_memory_is_bounded_by_the_window() -> None:
    clock = ClockMap(LATENCY_S)
    for number in range(20_000):
        clock.observe(number * 0.5, number * 0.5 + 0.03)
    assert len(clock._buckets) < 20
    assert clock.uncertainty_s < 0.12


def test_a_clock_that_is_reset_maps_from_the_next_packet() -> None:
    clock = ClockMap(LATENCY_S)
    clock.observe(100.0, 5.0)
    clock.reset()
    assert clock.offset_s is None
    assert clock.observe(0.0, 6.0) == 6.0
