"""The forecast: the better model by its own backtest, a band that holds, and never from too little."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_devices.forecast import TooShort, forecast, needed_intervals

DAY = 24


def days(count: int, noise: float = 0.1, seed: int = 1) -> np.ndarray:
    """Hourly values of days with a morning and an evening."""
    hours = np.arange(count * DAY)
    usual = 20 + 5 * np.sin(2 * np.pi * hours / DAY) + 2 * np.sin(4 * np.pi * hours / DAY)
    return usual + np.random.default_rng(seed).normal(0, noise, hours.size)


def test_a_daily_pattern_is_forecast_by_the_day_before_and_better_than_the_last_value() -> None:
    values = days(8)
    found = forecast(values[:-DAY], DAY, DAY)
    assert found.method == "seasonalNaive"
    assert found.error < found.naive_error / 5
    inside = (values[-DAY:] >= found.low) & (values[-DAY:] <= found.high)
    assert inside.mean() >= 0.7  # 90 % are meant; 24 values of a fixed seed are few


def test_a_trend_is_forecast_by_the_damped_trend() -> None:
    values = np.arange(100) * 0.5
    found = forecast(values, 10)
    assert found.method == "dampedTrend"
    assert values[-1] < found.mean[0] < found.mean[-1] < values[-1] + 10 * 0.5
    assert found.error < found.naive_error


def test_the_backtest_sees_only_what_was_before() -> None:
    """A jump in the last day cannot be known before: it is in the measured error."""
    calm, jumped = days(8), days(8)
    jumped[-DAY // 2 :] += 50
    assert forecast(jumped, DAY, DAY).error > 5 * forecast(calm, DAY, DAY).error


def test_gaps_are_bridged_but_not_too_many() -> None:
    values = days(8)
    values[::10] = np.nan
    assert np.isfinite(forecast(values, DAY, DAY).mean).all()
    values[::3] = np.nan
    with pytest.raises(TooShort):
        forecast(values, DAY, DAY)


@settings(deadline=None, max_examples=40)
@given(
    size=st.integers(0, 120),
    horizon=st.integers(1, 30),
    season=st.none() | st.integers(2, 40),
    seed=st.integers(0, 9),
)
def test_any_length_gives_a_finite_band_or_says_what_is_needed(
    size: int, horizon: int, season: int | None, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(0, 1, size)
    if size < needed_intervals(horizon):
        with pytest.raises(TooShort) as short:
            forecast(values, horizon, season)
        assert short.value.needed == needed_intervals(horizon)
        return
    found = forecast(values, horizon, season)
    assert found.mean.shape == found.low.shape == found.high.shape == (horizon,)
    assert np.isfinite(found.mean).all()
    widths = found.high - found.low
    assert (widths >= 0).all()
    assert (np.diff(widths) >= -1e-9).all()
    assert found.origins >= 5
