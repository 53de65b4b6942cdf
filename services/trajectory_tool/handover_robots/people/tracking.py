"""Clusters of points become people whose ids stay the same from one measurement to the next.

A person who is not measured for `REJOIN_S` gets a new id when they are measured again: it may be somebody
else. The limits then keep the last place of the former id, until a person confirms that nobody is there.
Two people so near to each other that they are one cluster have the same place.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handover_datamodels.streams import MAX_PEOPLE, SeenPerson
from handover_robots.limits.separation import JUMP_M, MAX_PERSON_MPS, Point

GRID_M = 0.15
"""Points in neighbouring cells of this grid belong together."""
REJOIN_S = 0.5


@dataclass(frozen=True, slots=True)
class Cluster:
    """Points that belong together: their middle, and the greatest distance from it."""

    middle: Point
    radius_m: float


def clusters(points: NDArray[np.float64], min_points: int) -> list[Cluster]:
    """Return the clusters of horizontal points with at least `min_points`."""
    cells: dict[tuple[int, int], list[int]] = {}
    for number, (column, row) in enumerate(np.floor(points[:, :2] / GRID_M).astype(int).tolist()):
        cells.setdefault((column, row), []).append(number)
    dense = []
    while cells:
        waiting, members = [next(iter(cells))], list[int]()
        while waiting:
            column, row = waiting.pop()
            members += cells.pop((column, row), [])
            waiting += [
                (column + across, row + along)
                for across in (-1, 0, 1)
                for along in (-1, 0, 1)
                if (column + across, row + along) in cells
            ]
        if len(members) >= min_points:
            of_cluster = points[members, :2]
            middle = (of_cluster.min(axis=0) + of_cluster.max(axis=0)) / 2
            radius_m = float(np.linalg.norm(of_cluster - middle, axis=1).max())
            dense.append(Cluster((float(middle[0]), float(middle[1])), radius_m))
    return dense


class Tracker:
    """Gives ids to the clusters of one sensor; `name` begins each id."""

    def __init__(self, name: str) -> None:
        self._name = name[:48]
        self._count = 0
        self._tracks: dict[str, tuple[Point, float]] = {}

    def people(self, measured: Sequence[Cluster], stamp_s: float) -> tuple[SeenPerson, ...]:
        """Return the people of a measurement; a measurement must be later than the one before."""
        tracks = {name: track for name, track in self._tracks.items() if stamp_s - track[1] <= REJOIN_S}
        pairs = sorted(
            (math.dist(place, cluster.middle), name, number)
            for name, (place, seen_s) in tracks.items()
            for number, cluster in enumerate(measured)
            if math.dist(place, cluster.middle) <= MAX_PERSON_MPS * (stamp_s - seen_s) + JUMP_M
        )
        of_name: dict[str, int] = {}
        for _, name, number in pairs:  # the nearest first, each cluster once
            if name not in of_name and number not in of_name.values():
                of_name[name] = number
        followed = set(of_name.values())
        for _, name, number in pairs:  # what is left may be in the cluster of another
            of_name.setdefault(name, number)
        for number in range(len(measured)):
            if number not in followed:
                self._count += 1
                of_name[f"{self._name}.{self._count}"] = number
        self._tracks = {
            **tracks,
            **{name: (measured[number].middle, stamp_s) for name, number in of_name.items()},
        }
        return tuple(_seen(name, measured[number]) for name, number in of_name.items())[:MAX_PEOPLE]


def _seen(name: str, cluster: Cluster) -> SeenPerson:
    x, y = cluster.middle
    return SeenPerson(id=name, x=round(x, 4), y=round(y, 4), radius=round(cluster.radius_m, 4))
