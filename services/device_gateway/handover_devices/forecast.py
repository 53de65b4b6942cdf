"""Forecast of one series: two simple models, chosen by their error on the series itself.

- `seasonalNaive`: each interval is as the same interval of the day before.
- `dampedTrend`: Holt's linear trend with a damped slope (Gardner and McKenzie, Forecasting trends in time
  series, Management Science 31, 1985), its smoothing chosen by the squared error of one step.

Both are compared by a rolling origin (Tashman, Out-of-sample tests of forecasting accuracy, International
Journal of Forecasting 16, 2000): from each of up to `MAX_ORIGINS` earlier times the model sees only what was
before, and forecasts the whole horizon. The model with the lesser mean absolute error is used; `naive_error`
is that of repeating the last value. The band holds 90 % of the errors of the backtest for each step, and
never becomes narrower with time. It is empirical: nothing is claimed for what has never happened.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Model = Callable[[Values, int], Values]

MAX_ORIGINS: Final = 20
MIN_ORIGINS: Final = 5
MIN_KNOWN: Final = 20
"""Intervals before the first origin."""
MIN_PRESENT: Final = 0.8
"""The fraction of intervals that must have values; the others are interpolated."""
COVERAGE: Final = 0.9
PHI: Final = 0.95
_ALPHAS: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
_BETAS: Final = (0.0, 0.05, 0.2)


class TooShort(Exception):
    """The history has not enough values; `needed` intervals are needed, of which `present` have values."""

    def __init__(self, needed: int, present: int) -> None:
        super().__init__(f"{needed} intervals needed, {present} present")
        self.needed = needed
        self.present = present


@dataclass(frozen=True, slots=True)
class Forecast:
    """The forecast of each step with its band, and the errors of the backtest, in the unit of the values."""

    method: str
    mean: Values
    low: Values
    high: Values
    error: float
    naive_error: float
    origins: int


def needed_intervals(horizon: int) -> int:
    """Return how many intervals `forecast` needs for a horizon of so many steps."""
    return MIN_KNOWN + horizon + MIN_ORIGINS - 1


def forecast(values: Values, horizon: int, season: int | None = None) -> Forecast:
    """Forecast `horizon` steps after `values` (oldest first, NaN where there is none); raise `TooShort`.

    `season` is the number of steps of a day; without it, and with less than two days before the first origin,
    there is no seasonal model.
    """
    needed = needed_intervals(horizon)
    present = int(np.isfinite(values).sum())
    first = int(np.argmax(np.isfinite(values))) if present else 0
    values = values[first:]
    if values.size < needed or present < MIN_PRESENT * values.size:
        raise TooShort(needed, present)
    filled = _interpolated(values)
    origins = min(MAX_ORIGINS, filled.size - MIN_KNOWN - horizon + 1)
    models: dict[str, Model] = {"dampedTrend": damped_trend}
    if season is not None and filled.size - horizon - MIN_ORIGINS + 1 >= 2 * season:
        models["seasonalNaive"] = lambda before, steps: seasonal_naive(before, steps, season)
        origins = min(origins, filled.size - horizon - 2 * season + 1)
    errors = {name: _rolling_errors(filled, horizon, origins, model) for name, model in models.items()}
    naive = _rolling_errors(filled, horizon, origins, lambda before, steps: np.full(steps, before[-1]))
    method = min(errors, key=lambda name: float(errors[name].mean()))
    mean = models[method](filled, horizon)
    band = np.maximum.accumulate(np.quantile(errors[method], COVERAGE, axis=0))
    error = float(errors[method].mean())
    return Forecast(method, mean, mean - band, mean + band, error, float(naive.mean()), origins)


def seasonal_naive(before: Values, horizon: int, season: int) -> Values:
    """Repeat the last season."""
    repeated: Values = np.resize(before[-season:], horizon)
    return repeated


def damped_trend(before: Values, horizon: int) -> Values:
    """Return the forecast of Holt's method with a damped trend."""
    best, chosen = math.inf, (float(before[-1]), 0.0)
    for alpha in _ALPHAS:
        for beta in _BETAS:
            squared, level, slope = _smoothed(before, alpha, beta)
            if squared < best:
                best, chosen = squared, (level, slope)
    level, slope = chosen
    damping: Values = np.cumsum(PHI ** np.arange(1, horizon + 1))
    expected: Values = level + slope * damping
    return expected


def _smoothed(values: Values, alpha: float, beta: float) -> tuple[float, float, float]:
    """Return the squared error of one step, the last level and the last slope."""
    level, slope, squared = float(values[0]), 0.0, 0.0
    for value in values[1:].tolist():
        expected = level + PHI * slope
        fault = value - expected
        squared += fault * fault
        level = expected + alpha * fault
        slope = PHI * slope + alpha * beta * fault
    return squared, level, slope


def _rolling_errors(values: Values, horizon: int, origins: int, model: Model) -> Values:
    """Return the absolute errors, an array of origins x horizon."""
    errors = []
    for back in range(origins):
        end = values.size - horizon - back
        errors.append(np.abs(model(values[:end], horizon) - values[end : end + horizon]))
    return np.array(errors)


def _interpolated(values: Values) -> Values:
    places = np.flatnonzero(np.isfinite(values))
    filled: Values = np.interp(np.arange(values.size), places, values[places])
    return filled
