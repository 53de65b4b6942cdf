"""The cells that share a tenant of a broker: what belongs to which.

The orchestrator of each cell writes one `Cell`, whose id has the name of the cell. An entity whose id has the
name of another cell is of that cell; every other one, as those of FIWARE components with other ids, is for
all.
"""

from typing import Final

from datamodels.entities import Cell
from handover.broker import BrokerClient
from handover.settings import Settings

_PREFIX: Final = "urn:ngsi-ld:"


def cell_of(entity_id: str) -> str | None:
    """Return the name of a cell in an id `urn:ngsi-ld:<Type>:<cell>:<name>`; None in any other id."""
    if not entity_id.startswith(_PREFIX):
        return None
    parts = entity_id.split(":", 4)
    return parts[3] if len(parts) == 5 else None


class OtherCells:
    """The other cells of the tenant, as they were when `read` was awaited last."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._own = settings.factory
        self._broker = broker
        self._others: frozenset[str] = frozenset()

    async def read(self) -> None:
        """Read which cells there are. Raises `BrokerError`."""
        cells = await self._broker.query(type=Cell.ngsi_type(), attrs=["cellState"])
        names = {cell_of(str(entity.get("id"))) for entity in cells}
        self._others = frozenset(name for name in names if name is not None) - {self._own}

    def has(self, entity_id: object) -> bool:
        """Return whether an entity is of another cell."""
        return bool(self._others) and cell_of(str(entity_id)) in self._others
