"""Pressure maps to load, active cells and the centre of pressure.

The centre is the mean of the positions of the cells, weighted by load; x to the right, y forwards, in mm
from the middle of the mat. Positions stand in the names of the channels: `x-50y120` in mm, for mats that
are no regular grid, or `r0c3` for row (0 is the front) and column at a pitch of 100 mm. Without positions
there is no centre.
"""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo

METHOD: Final = "pressure-1"
PITCH_MM: Final = 100.0
ACTIVE_SHARE: Final = 0.02
"""Of the range of a cell; less is noise."""
MIN_ACTIVE_CELLS: Final = 2
_PLACE: Final = re.compile(r"x(-?\d{1,5}(?:\.\d+)?)y(-?\d{1,5}(?:\.\d+)?)")
_CELL: Final = re.compile(r"r(\d{1,3})c(\d{1,3})")


def cell_positions_mm(channels: tuple[str, ...]) -> NDArray[np.float64] | None:
    """Return the (x, y) of each cell in mm, or None if a name has none."""
    places = [_PLACE.fullmatch(name) for name in channels]
    if all(places):
        return np.array([[float(place[1]), float(place[2])] for place in places if place])
    cells = [_CELL.fullmatch(name) for name in channels]
    if not all(cells):
        return None
    grid = np.array([[float(cell[2]), -float(cell[1])] for cell in cells if cell])
    return np.asarray((grid - (grid.max(axis=0) + grid.min(axis=0)) / 2) * PITCH_MM, np.float64)


class PressureProcessor:
    """A pressure map of any unit, one channel a cell. A value for each packet."""

    def __init__(self, info: SignalInfo) -> None:
        self._positions: Final = cell_positions_mm(info.channels)
        bounded = np.isfinite(info.max_value) and np.isfinite(info.min_value)
        self._zero: Final = info.min_value if np.isfinite(info.min_value) else 0.0
        self._threshold: Final = ACTIVE_SHARE * (info.max_value - info.min_value) if bounded else 0.0
        self._period_s: Final = 1 / info.rate_hz if info.rate_hz else 1.0

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Return the load of the newest map and, with two active cells or more, its centre."""
        load = np.maximum(samples.values[-1] - self._zero, 0)
        load = np.where(load > self._threshold, load, 0)
        total, active = float(load.sum()), int(np.count_nonzero(load))
        values = [(FeatureName.LOAD, total), (FeatureName.ACTIVE_CELLS, float(active))]
        if self._positions is not None and active >= MIN_ACTIVE_CELLS and total > 0:
            x_mm, y_mm = (load[:, None] * self._positions).sum(axis=0) / total
            values += [
                (FeatureName.CENTRE_OF_PRESSURE_X, float(x_mm)),
                (FeatureName.CENTRE_OF_PRESSURE_Y, float(y_mm)),
            ]
        period_s = max(self._period_s, len(samples.values) * self._period_s)
        return [
            Feature(
                name,
                samples.source,
                value,
                samples.end_s,
                samples.quality,
                Status.VALID,
                METHOD,
                0.0,
                period_s,
            )
            for name, value in values
        ]

    def report(self, report: SensorReport) -> Sequence[Feature]:  # noqa: ARG002 -- nothing is kept
        """Keep nothing: each map stands for itself."""
        return []
