"""Which operations other context sources have a share in, and how each is done with them (table 4.20-1)."""

from collections.abc import Mapping
from typing import Final

from services.context_broker.distribution import discovery, history, reading, writing
from services.context_broker.distribution.batches import batch
from services.context_broker.distribution.distribution import Handling
from services.context_broker.distribution.mapping import map_past
from services.context_broker.distribution.purge import purge

HANDLINGS: Final[Mapping[str, Handling]] = {
    "retrieveEntity": reading.retrieve,
    "queryEntity": reading.query,
    "queryBatch": reading.query_batch,
    "createEntityMapQueryEntity": reading.map_entities,
    "createEntityMapQueryTemporal": map_past,
    **{
        name: batch(name)
        for name in ("createBatch", "upsertBatch", "updateBatch", "mergeBatch", "deleteBatch")
    },
    "retrieveTemporal": history.retrieve,
    "queryTemporal": history.query,
    "queryTemporalBatch": history.query_batch,
    "retrieveEntityTypes": discovery.types,
    "retrieveEntityTypeInfo": discovery.type_details,
    "retrieveAttrTypes": discovery.attributes,
    "retrieveAttrTypeInfo": discovery.attribute_details,
    "createEntity": writing.create,
    "replaceEntity": writing.change_entity,
    "mergeEntity": writing.change_entity,
    "deleteEntity": writing.delete,
    "purgeEntity": purge,
    "upsertTemporal": writing.create,
    "appendAttrsTemporal": writing.change_attributes,
    "deleteAttrsTemporal": writing.change_attribute,
    "updateAttrInstanceTemporal": writing.change_attribute,
    "deleteAttrInstanceTemporal": writing.change_attribute,
    "deleteTemporal": writing.delete,
    "appendAttrs": writing.change_attributes,
    "updateEntity": writing.change_attributes,
    "updateAttrs": writing.change_attribute,
    "replaceAttrs": writing.change_attribute,
    "deleteAttrs": writing.change_attribute,
}
