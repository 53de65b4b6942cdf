"""Index of the geometries of one attribute: grids over the globe with cells of different sizes.

A change of a geometry updates a few cells, so moving robots do not cause a rebuild.
"""

from collections.abc import Iterable, Iterator
from typing import Any, Final

from prometheus_client import Counter

from handover.telemetry import get_logger
from handover_broker.model.entity import Entity
from handover_broker.model.geometry import fault_of
from handover_broker.query.geo_query import boxes_touch
from handover_broker.query.sphere import Box, box_of

log = get_logger(__name__)

SKIPPED: Final = Counter(
    "handover_broker_geometries_skipped_total",
    "Invalid stored geometries that geo-queries skip",
)

_SIZES_DEG: Final = (0.0001, 0.001, 0.01, 0.1, 1.0, 10.0)
"""Sides of the cells, from some ten metres on; a grid is created when a query first needs it."""
_MOST_ASKED: Final = 64
"""Maximum cells that a query reads; for a larger area a coarser grid is used."""
_MOST_FILED: Final = 16
"""Maximum cells of a geometry; larger ones are checked by each query."""

Cell = tuple[int, int]
Ids = dict[str, None]


class PlaceIndex:
    """The entities by the geometries of one attribute (an IRI)."""

    def __init__(self, attribute: str, entities: Iterable[Entity]) -> None:
        self._attribute = attribute
        self._boxes: dict[str, list[Box]] = {}
        self._grids: dict[float, _Grid] = {}
        for entity in entities:
            self.refile(None, entity)

    def __len__(self) -> int:
        """Return how many entities have a geometry."""
        return len(self._boxes)

    def refile(self, before: Entity | None, after: Entity | None) -> None:
        """Update the index after a change of an entity."""
        instances_before = () if before is None else before.attributes.get(self._attribute, ())
        instances_after = () if after is None else after.attributes.get(self._attribute, ())
        if instances_before is instances_after:
            return
        if before is not None and (boxes := self._boxes.pop(before.id, None)):
            for grid in self._grids.values():
                grid.take_out(before.id, boxes)
        if after is not None and (boxes := _boxes(after.id, self._attribute, instances_after)):
            self._boxes[after.id] = boxes
            for grid in self._grids.values():
                grid.put_in(after.id, boxes)

    def found(self, box: Box) -> list[str]:
        """Return the ids of entities with a geometry that may touch `box`."""
        west, south, east, north = box
        if east - west >= 360:
            west, east = -180.0, 180.0
        turns = [
            (west + turn, max(south, -90.0), east + turn, min(north, 90.0)) for turn in (0.0, 360.0, -360.0)
        ]
        grid = self._grid(turns[0])
        hits: Ids = {}
        for shift in turns:
            hits.update(grid.touched(shift))
        return [hit for hit in hits if any(boxes_touch(box, other) for other in self._boxes[hit])]

    def _grid(self, box: Box) -> "_Grid":
        size = next((size for size in _SIZES_DEG if _count(box, size) <= _MOST_ASKED), _SIZES_DEG[-1])
        grid = self._grids.get(size)
        if grid is None:
            grid = self._grids[size] = _Grid(size)
            for entity_id, boxes in self._boxes.items():
                grid.put_in(entity_id, boxes)
        return grid


class _Grid:
    """Cells of one size, and their content."""

    def __init__(self, size_deg: float) -> None:
        self._size_deg = size_deg
        self._cells: dict[Cell, Ids] = {}
        self._wide: Ids = {}

    def put_in(self, entity_id: str, boxes: list[Box]) -> None:
        for box in boxes:
            if _count(box, self._size_deg) > _MOST_FILED:
                self._wide[entity_id] = None
                continue
            for cell in _cells(box, self._size_deg):
                self._cells.setdefault(cell, {})[entity_id] = None

    def take_out(self, entity_id: str, boxes: list[Box]) -> None:
        self._wide.pop(entity_id, None)
        for box in boxes:
            if _count(box, self._size_deg) > _MOST_FILED:
                continue
            for cell in _cells(box, self._size_deg):
                ids = self._cells.get(cell)
                if ids is not None:
                    ids.pop(entity_id, None)
                    if not ids:
                        del self._cells[cell]

    def touched(self, box: Box) -> Ids:
        hits: Ids = dict(self._wide)
        if _count(box, self._size_deg) <= len(self._cells):
            for cell in _cells(box, self._size_deg):
                hits.update(self._cells.get(cell, {}))
            return hits
        west, south, east, north = (int(side / self._size_deg // 1) for side in box)
        for (x, y), ids in self._cells.items():
            if west <= x <= east and south <= y <= north:
                hits.update(ids)
        return hits


def _boxes(entity_id: str, attribute: str, instances: Iterable[dict[str, Any]]) -> list[Box]:
    """Return the boxes of the valid geometries; old ones were stored without a check."""
    boxes = []
    for instance in instances:
        if instance["type"] != "GeoProperty":
            continue
        if (fault := fault_of(instance["value"])) is None:
            boxes.append(box_of(instance["value"]))
        else:
            SKIPPED.inc()
            log.warning("stored geometry skipped", entity=entity_id, attribute=attribute, fault=fault)
    return boxes


def _count(box: Box, size_deg: float) -> int:
    west, south, east, north = (int(side / size_deg // 1) for side in box)
    return (east - west + 1) * (north - south + 1)


def _cells(box: Box, size_deg: float) -> Iterator[Cell]:
    west, south, east, north = (int(side / size_deg // 1) for side in box)
    for x in range(west, east + 1):
        for y in range(south, north + 1):
            yield x, y
