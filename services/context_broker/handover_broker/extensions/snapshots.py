"""The interface to snapshots: copies of query results that are kept apart and queried with NGSILD-Snapshot.

The application passes requests that name a snapshot to a `Snapshots`. `NoSnapshots` refuses them.
The plugin `snapshots` is the full implementation (`handover_federation.snapshots`). The application loads it,
and a broker with HANDOVER_BROKER_SNAPSHOTS=false does not.
"""

from collections.abc import Callable
from typing import Final, Protocol

from handover_broker.extensions.plugins import CarryOut, PerformByName, Plugin, unsupported, warn_of_stored
from handover_broker.model.problems import not_supported
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal
from handover_broker.tenants import Tenants

SNAPSHOT_HEADER: Final = b"ngsild-snapshot"
SNAPSHOTS: Final = Plugin("snapshots", "snapshots", "HANDOVER_BROKER_SNAPSHOTS")
_OPERATIONS: Final = (
    ("POST", "snapshots", "createSnapshot", "6.36.3.1"),
    ("DELETE", "snapshots", "purgeSnapshots", "6.36.3.2"),
    ("GET", "snapshots/{id}", "retrieveSnapshotStatus", "6.37.3.1"),
    ("PATCH", "snapshots/{id}", "updateSnapshotStatus", "6.37.3.2"),
    ("DELETE", "snapshots/{id}", "deleteSnapshot", "6.37.3.3"),
    ("POST", "snapshots/{id}/clone", "cloneSnapshot", "6.38.3.1"),
)
SNAPSHOT_OPERATIONS: Final = frozenset(name for _, _, name, _ in _OPERATIONS)
"""Operations on snapshots themselves; NGSILD-Snapshot does not change what they are about."""


class Snapshots(Protocol):
    """Creates snapshots, keeps them and carries out operations inside of them."""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations on snapshots."""

    def restore(self, journal: Journal) -> None:
        """Load the snapshots; all tenants are loaded already."""

    async def start(self, journal: Journal) -> None:
        """Start the background work; call it once everything is restored."""

    async def stop(self) -> None:
        """Stop the background work."""

    async def answer(self, operation: Operation, request: RequestContext, carry_out: CarryOut) -> Response:
        """Carry out an operation inside the snapshot that the request names."""


SnapshotsFactory = Callable[[Tenants, CarryOut, PerformByName], Snapshots]
"""What the entry point of the plugin is."""


class NoSnapshots:
    """A broker without snapshots."""

    def __init__(self) -> None:
        self._reason = SNAPSHOTS.missing()

    def operations(self) -> tuple[Operation, ...]:
        return unsupported(_OPERATIONS, self._reason)

    def restore(self, journal: Journal) -> None:
        warn_of_stored(journal, DocumentKind.SNAPSHOT, SNAPSHOTS)

    async def start(self, journal: Journal) -> None:
        return

    async def stop(self) -> None:
        return

    async def answer(self, operation: Operation, request: RequestContext, carry_out: CarryOut) -> Response:
        raise not_supported(self._reason)


def is_inside_snapshot(operation: Operation, request: RequestContext) -> bool:
    """Return whether an operation is about the content of a snapshot (clause 6.3.22)."""
    return SNAPSHOT_HEADER in request.headers and operation.name not in SNAPSHOT_OPERATIONS
