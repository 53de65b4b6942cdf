"""Operations of a part that is switched off: their paths answer 422 OperationNotSupported."""

from collections.abc import Iterable

from handover.telemetry import get_logger
from handover_broker.model.problems import not_supported
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal

log = get_logger(__name__)

Listed = tuple[str, str, str, str]
"""Method, path, name and clause of an operation."""


class _AnyParameter(frozenset[str]):
    """All query parameters: the request is refused for the operation, not for its parameters."""

    def __contains__(self, name: object) -> bool:
        return True


def unsupported(listed: Iterable[Listed], detail: str) -> tuple[Operation, ...]:
    """Return the operations as ones that are refused with `detail`, whatever their parameters are."""

    async def refuse(request: RequestContext) -> Response:  # noqa: ARG001 - as all operations
        raise not_supported(detail)

    return tuple(Operation(*one, refuse, _AnyParameter(), of_no_tenant=True) for one in listed)


def warn_of_stored(journal: Journal, kind: DocumentKind, setting: str) -> None:
    """Log a warning if the database has documents of a part that is switched off; they stay stored."""
    if count := sum(1 for _ in journal.documents(kind)):
        log.warning("stored documents are ignored", kind=kind.value, count=count, setting=setting)
