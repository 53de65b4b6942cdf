"""The age of a value: it is stale when newer ones are missing, measured by its own period."""

import pytest

from services.device_gateway.registry.device import LatestValue


def sent_every(period_s: float, times: int = 20) -> LatestValue:
    value = LatestValue(0.0, 0.0)
    for number in range(1, times):
        value.replace(number * period_s, 1.0)
    return value


@pytest.mark.parametrize(("period_s", "stale_after_s"), [(0.1, 10.0), (1.0, 10.0), (60.0, 180.0)])
def test_a_value_is_stale_after_three_of_its_periods_and_ten_seconds(
    period_s: float, stale_after_s: float
) -> None:
    value = sent_every(period_s)
    assert not value.is_stale(value.t + 0.99 * stale_after_s)
    assert value.is_stale(value.t + 1.01 * stale_after_s)


def test_the_first_value_is_stale_after_a_minute() -> None:
    assert not LatestValue(0.0, 1.0).is_stale(59.0)
    assert LatestValue(0.0, 1.0).is_stale(61.0)


def test_a_long_pause_counts_little_in_the_period() -> None:
    value = sent_every(1.0)
    value.replace(value.t + 86_400.0, 1.0)
    assert value.is_stale(value.t + 11.0)
    replayed = LatestValue(0.0, 1.0)
    replayed.replace(86_400.0, 2.0)
    assert replayed.is_stale(replayed.t + 901.0)
