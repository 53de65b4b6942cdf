"""The access that each operation needs."""

from enum import Enum, auto
from typing import Final

from handover_broker.request.routing import Operation


class OperationAccess(Enum):
    """What an operation asks of its caller."""

    OWN_CREDENTIAL = auto()
    """Its path has a secret of its own."""
    READ_ENTITIES = auto()
    """Reads entities: those that the caller may see."""
    READ_TENANT = auto()
    """Reads what is derived from all entities, or concerns the whole broker."""
    WRITE_ENTITIES = auto()
    """Changes the entities in its path or body, each with a permission of its own."""
    MANAGE_TENANT = auto()
    """Changes or reads what concerns a whole tenant: subscriptions with their keys, registrations, @contexts.
    """


_OF_NAME: Final = {
    **dict.fromkeys(("receiveSourceNotification",), OperationAccess.OWN_CREDENTIAL),
    **dict.fromkeys(
        (
            "queryEntity",
            "retrieveEntity",
            "queryBatch",
            "queryTemporal",
            "queryTemporalBatch",
            "retrieveTemporal",
        ),
        OperationAccess.READ_ENTITIES,
    ),
    **dict.fromkeys(
        (
            "retrieveEntityTypes",
            "retrieveEntityTypeInfo",
            "retrieveAttrTypes",
            "retrieveAttrTypeInfo",
            "retrieveContextSourceIdentity",
            "retrieveEntityMap",
            "createEntityMapQueryEntity",
            "createEntityMapQueryTemporal",
            "retrieveSnapshotStatus",
            "listContexts",
            "retrieveContext",
        ),
        OperationAccess.READ_TENANT,
    ),
    **dict.fromkeys(
        (
            "createEntity",
            "deleteEntity",
            "replaceEntity",
            "mergeEntity",
            "appendAttrs",
            "updateEntity",
            "updateAttrs",
            "deleteAttrs",
            "replaceAttrs",
            "createBatch",
            "upsertBatch",
            "updateBatch",
            "deleteBatch",
            "mergeBatch",
        ),
        OperationAccess.WRITE_ENTITIES,
    ),
    **dict.fromkeys(
        (
            "purgeEntity",
            "upsertTemporal",
            "deleteTemporal",
            "appendAttrsTemporal",
            "deleteAttrsTemporal",
            "updateAttrInstanceTemporal",
            "deleteAttrInstanceTemporal",
            "createSubscription",
            "querySubscription",
            "retrieveSubscription",
            "updateSubscription",
            "deleteSubscription",
            "createCSR",
            "queryCSR",
            "retrieveCSR",
            "updateCSR",
            "deleteCSR",
            "createCSRSubscription",
            "queryCSRSubscription",
            "retrieveCSRSubscription",
            "updateCSRSubscription",
            "deleteCSRSubscription",
            "updateEntityMap",
            "deleteEntityMap",
            "createSnapshot",
            "purgeSnapshots",
            "updateSnapshotStatus",
            "deleteSnapshot",
            "cloneSnapshot",
            "createContext",
            "deleteContext",
        ),
        OperationAccess.MANAGE_TENANT,
    ),
}


def access_of(operation: Operation) -> OperationAccess:
    """Return the access that `operation` needs; an unknown one needs the most."""
    return _OF_NAME.get(operation.name, OperationAccess.MANAGE_TENANT)


def has_access_class(operation: Operation) -> bool:
    """Return whether the access of `operation` is listed."""
    return operation.name in _OF_NAME
