"""Operations on the @contexts that the broker stores (clauses 5.13.2 to 5.13.5, 6.29 and 6.30)."""

from collections.abc import Mapping
from typing import Any, Final

import orjson

from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.contexts.context_store import PATH, ContextKind, StoredContext
from handover_broker.model.problems import bad_request_data, invalid_request, not_found, not_supported
from handover_broker.model.validation import shown
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation

DONE: Final = Response(204)


class ContextOperations:
    """Operations on @contexts."""

    def __init__(self, contexts: ContextResolver) -> None:
        self._contexts = contexts

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        all_of_them, by_id = "jsonldContexts", "jsonldContexts/{contextId}"
        kinds, details = frozenset({"details", "kind"}), frozenset({"details"})
        return (
            Operation("POST", all_of_them, "createContext", "6.29.3.1", self.add, makes_tenant=True),
            Operation("GET", all_of_them, "listContexts", "6.29.3.2", self.list, kinds),
            Operation("GET", by_id, "retrieveContext", "6.30.3.1", self.serve, details),
            Operation("DELETE", by_id, "deleteContext", "6.30.3.2", self.delete, frozenset({"reload"})),
        )

    async def add(self, request: RequestContext) -> Response:
        """POST jsonldContexts: the @context is in the body, with any media type."""
        request.content_type()
        document = request.document()
        if not isinstance(document, Mapping) or document.get("@context") is None:
            raise invalid_request('the body is an object with an "@context"; put the context there')
        added = await self._contexts.add(request.tenant.name, document["@context"])
        location = added.address("")  # relative, as in table 6.29.3.1-1
        return Response(201, b"", [(b"location", location.encode())])

    async def list(self, request: RequestContext) -> Response:
        """GET jsonldContexts: their URLs; with details=true their use too."""
        media_type, base = request.accept(), self._contexts.base(request.headers)
        kind = request.parameter("kind")
        if kind is not None and kind not in set(ContextKind):
            raise bad_request_data(f"kind is one of {', '.join(ContextKind)}, not {shown(kind)}")
        stored_contexts = [
            context for context in self._contexts.all(request.tenant.name) if kind in {None, context.kind}
        ]
        if request.flag("details"):
            return _answer([stored.details(base) for stored in stored_contexts], media_type)
        return _answer([stored.address(base) for stored in stored_contexts], media_type)

    async def serve(self, request: RequestContext) -> Response:
        """GET jsonldContexts/{contextId}: its content, with details=true its use.

        A request without a tenant gets the content of any tenant's context: a client that reads an @context
        from a Link header cannot name a tenant, and the identifier cannot be guessed. Another tenant gets
        404.
        """
        media_type = request.accept()
        if request.flag("details"):
            hosted = self._existing(request)
            description = hosted.details(self._contexts.base(request.headers))
            if hosted.kind is ContextKind.CACHED and not self._contexts.is_shipped(hosted):
                self._contexts.usage.seen(hosted)
            return _answer(description, media_type)
        stored = self._contexts.named(request.names[0], request.tenant.name)
        if stored is None and not request.tenant.name:
            stored = self._contexts.served(request.names[0])
        if stored is None:
            raise _absent(request)
        if stored.kind is ContextKind.CACHED:
            raise not_supported(
                f"the broker serves its own contexts only; get {stored.url} where it is published, "
                "or add details=true to see its use here"
            )
        return _answer(stored.document, media_type)

    async def delete(self, request: RequestContext) -> Response:
        """DELETE jsonldContexts/{contextId}; with reload=true a cached one is fetched again."""
        stored = self._existing(request)
        again = request.flag("reload")
        if self._contexts.is_core(stored):
            if again:  # it is the same in all versions of the broker's core context: nothing to fetch
                return DONE
            raise bad_request_data("the core @context is part of the broker and stays; leave it as it is")
        if again:
            if stored.kind is not ContextKind.CACHED:
                raise bad_request_data(
                    f"{stored.id} is {stored.kind} and has no URL to fetch it from; delete it without "
                    "reload, and add it again"
                )
            await self._contexts.reload(stored)
            return DONE
        if self._contexts.is_shipped(stored):
            raise bad_request_data(
                f"{stored.url} is shipped with the broker and stays; reload=true fetches what is published "
                "there"
            )
        await self._contexts.delete(stored)
        return DONE

    def _existing(self, request: RequestContext) -> StoredContext:
        stored = self._contexts.named(request.names[0], request.tenant.name)
        if stored is None:
            raise _absent(request)
        return stored


def _absent(request: RequestContext) -> Exception:
    return not_found(
        f"there is no @context {shown(request.names[0])}; GET {PATH.rstrip('/')} lists those there are"
    )


def _answer(body: Any, media_type: str) -> Response:
    return Response(200, orjson.dumps(body), [(b"content-type", media_type.encode())])
