"""Operations of a part that is switched off: their paths answer 422 OperationNotSupported."""

from collections.abc import Iterable

from services.context_broker.model.problems import not_supported
from services.context_broker.request.request_context import RequestContext, Response
from services.context_broker.request.routing import Operation

Listed = tuple[str, str, str, str]
"""Method, path, name and clause of an operation."""


class _AnyParameter(frozenset[str]):
    """All query parameters: the request is refused for the operation, not for its parameters."""

    def __contains__(self, name: object) -> bool:
        return True


def unsupported(listed: Iterable[Listed], detail: str) -> tuple[Operation, ...]:
    """Return the operations as ones that are refused with `detail`, whatever their parameters are."""

    async def refuse(exchange: RequestContext) -> Response:  # noqa: ARG001 - as all operations
        raise not_supported(detail)

    return tuple(Operation(*one, refuse, _AnyParameter(), of_no_tenant=True) for one in listed)
