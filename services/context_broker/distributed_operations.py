"""Which operations other context sources have a share in, and how each is done with them (table 4.20-1)."""

from collections.abc import Mapping
from typing import Final

from services.context_broker import distributed_reading as reading
from services.context_broker.distribution import Handling

HANDLINGS: Final[Mapping[str, Handling]] = {
    "retrieveEntity": reading.retrieve,
    "queryEntity": reading.query,
    "queryBatch": reading.query_batch,
    "createEntityMapQueryEntity": reading.query_by_method,
}
