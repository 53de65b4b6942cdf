"""The handlers of distributed operations by their name (table 4.20-1)."""

from collections.abc import Mapping
from typing import Final

from handover_federation.distribution.distributed_operations import Handler
from handover_federation.distribution.reads import discovery, temporal_reading, temporal_retrieval
from handover_federation.distribution.reads import entity_reading as reading
from handover_federation.distribution.reads.entity_map_collection import map_temporal
from handover_federation.distribution.writes import entity_writing as writing
from handover_federation.distribution.writes.batches import batch
from handover_federation.distribution.writes.purge import purge

HANDLERS: Final[Mapping[str, Handler]] = {
    "retrieveEntity": reading.retrieve,
    "queryEntity": reading.query,
    "queryBatch": reading.query_batch,
    "createEntityMapQueryEntity": reading.map_entities,
    "createEntityMapQueryTemporal": map_temporal,
    **{
        name: batch(name)
        for name in ("createBatch", "upsertBatch", "updateBatch", "mergeBatch", "deleteBatch")
    },
    "retrieveTemporal": temporal_retrieval.retrieve,
    "queryTemporal": temporal_reading.query,
    "queryTemporalBatch": temporal_reading.query_batch,
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
