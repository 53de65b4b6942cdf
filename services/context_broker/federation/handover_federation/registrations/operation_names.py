"""Names of operations in registrations (clause 4.20).

Table 4.20-1 has the names, table 4.20-2 the groups of operations.
"""

from collections.abc import Iterable
from typing import Final

_DISCOVERY: Final = frozenset(
    {"retrieveEntityTypes", "retrieveEntityTypeDetails", "retrieveEntityTypeInfo", "retrieveAttrTypes",
     "retrieveAttrTypeDetails", "retrieveAttrTypeInfo"}
)  # fmt: skip
_SUBSCRIBING: Final = frozenset(
    {"createSubscription", "updateSubscription", "retrieveSubscription", "querySubscription",
     "deleteSubscription"}
)  # fmt: skip
_ENTITY_MAPS: Final = frozenset(
    {"retrieveEntityMap", "updateEntityMap", "deleteEntityMap", "createEntityMapQueryEntity"}
)  # fmt: skip
_RETRIEVING: Final = frozenset({"retrieveEntity", "queryEntity"})
_UPDATING: Final = frozenset({"updateEntity", "updateAttrs", "replaceEntity", "replaceAttrs"})
_IDENTITY: Final = frozenset({"retrieveContextSourceIdentity"})
_ASSOCIATING: Final = _RETRIEVING | _DISCOVERY | _SUBSCRIBING | _IDENTITY | {"queryBatch"}
_CHANGING: Final = _UPDATING | {
    "createEntity", "appendAttrs", "deleteAttrs", "deleteEntity", "mergeEntity", "purgeEntity"
}  # fmt: skip

TEMPORAL_READING: Final = frozenset({"retrieveTemporal", "queryTemporal", "createEntityMapQueryTemporal"})
"""Operations that read temporal data."""
TEMPORAL: Final = TEMPORAL_READING | {
    "upsertTemporal", "appendAttrsTemporal", "deleteAttrsTemporal", "updateAttrInstanceTemporal",
    "deleteAttrInstanceTemporal", "deleteTemporal"
}  # fmt: skip
BATCHES: Final = frozenset({"createBatch", "upsertBatch", "updateBatch", "mergeBatch", "deleteBatch"})

DEFAULT_GROUP: Final = "federationOps"
GROUPS: Final = {
    DEFAULT_GROUP: _ASSOCIATING | _ENTITY_MAPS,
    "associationOps": _ASSOCIATING,
    "updateOps": _UPDATING,
    "retrieveOps": _RETRIEVING,
    "redirectionOps": _CHANGING | _RETRIEVING | _DISCOVERY | _ENTITY_MAPS | _IDENTITY,
}
AUXILIARY_OPERATIONS: Final = _RETRIEVING
"""Operations that an auxiliary registration may name (clause 5.9.2.4)."""
NAMES: Final = _ASSOCIATING | _ENTITY_MAPS | _CHANGING | TEMPORAL | BATCHES


def operations_of(names: Iterable[str]) -> frozenset[str]:
    """Return the single operations for names of operations and groups."""
    result: set[str] = set()
    for name in names:
        result |= GROUPS.get(name, {name})
    return frozenset(result)
