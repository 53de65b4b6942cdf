"""Pages of entity maps: always full, and without entities that no longer match (clause 5.5.9.3).

A map fixes the candidates; whether they still match is checked when a page is read:

1. The entities of the page are queried by their ids, with the filters of the query. If all are found, that is
   the page (the usual case).
2. If some are missing, the candidates from the offset of the page on are checked in batches of
   `CHECK_BATCH_SIZE`. Those that no longer match are dropped, and the page is read again.
3. With a count, all candidates are checked first.

Example: the map has 1 to 9, the page is offset 3 and limit 3. Entity 5 is missing, so 4 to 9 are checked and
5 and 8 dropped. The page is 4, 6, 7, and the next link has offset 6 of the remaining 1, 2, 3, 4, 6, 7, 9.

Dropped entities are removed from the map if the request has the query that the map was created for. Another
query (with a narrower q, say) leaves the map as it is. While a source fails, nothing is dropped, because
missing entities may be there: the page is shorter then, and the response has a warning.

Invariant: links carry offsets into the remaining map. Removed entities lie behind the offset of the page or
are subtracted from the offsets in the links, so that a walk neither repeats nor skips entities.
"""

import asyncio
import hashlib
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from typing import Any, Final
from urllib.parse import quote

import orjson

from handover_broker.extensions.federation import MAP_OPTION
from handover_broker.query import linked, ordering
from handover_broker.query.pages import PLACE, Window
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import MAP_PARAMETERS, MAX_LIMIT, window_of
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.storage.database import NotStored
from handover_broker.temporal.query import temporal_window
from handover_federation.entity_maps.entity_map import EntityMap
from handover_federation.entity_maps.mapped_request import with_map
from handover_federation.tenant_state import federated

Perform = Callable[[RequestContext], Awaitable[Response]]
"""Carries out a query, context sources included."""

CHECK_BATCH_SIZE: Final = MAX_LIMIT
"""Candidates that are checked in one query."""
SHAPING: Final = frozenset({"options", "format", "count", "pick", "omit", "lang", "datasetId"})
"""Parameters of the representation, which do not change the matches."""
_WINDOW: Final = frozenset({"offset", "limit", PLACE})
_UNMARKED: Final = (
    SHAPING
    | MAP_PARAMETERS
    | _WINDOW
    | linked.PARAMETERS
    | ordering.PARAMETERS
    | {"geometryProperty", "local", "id"}
)
"""Parameters in which requests for pages of one map may differ."""
_COUNT: Final = b"ngsild-results-count"
_NO_ENTITY: Final = "urn:ngsi-ld:EntityMap:none"
"""Requested for an empty page, so that its response has the requested representation."""


async def map_page(request: RequestContext, entity_map: EntityMap, perform: Perform) -> Response:
    """Return the requested page of a map; remove from the map what no longer matches."""
    page = _Page(derived(request, parameters=for_the_query(request.parameters)), entity_map, perform)
    return await page.answer()


class _Page:
    """One page: `_ids` are the candidates, `_gone` those that no longer match."""

    def __init__(self, wanted: RequestContext, entity_map: EntityMap, perform: Perform) -> None:
        self._wanted = wanted
        self._map = entity_map
        self._perform = perform
        self._is_temporal = "/temporal/" in wanted.path
        self._window: Window = (temporal_window if self._is_temporal else window_of)(wanted)
        ids = _ids_in(wanted)
        self._ids = [entity for entity in entity_map.entities if ids is None or entity in ids]
        self._gone: set[str] = set()

    async def answer(self) -> Response:
        """Return the response, with links to the previous and next pages."""
        window = self._window
        if window.count:
            for start in range(0, len(self._ids), CHECK_BATCH_SIZE):
                await self._check(self._ids[start : start + CHECK_BATCH_SIZE])
        while True:
            some = self._left(window.limit)
            result, count = await self._shown(some)
            if count >= len(some) or _is_warned(result):
                break
            before = len(self._gone)
            await self._check(self._left(CHECK_BATCH_SIZE))
            if len(self._gone) == before:
                break
        if result.status >= 300:
            return result
        is_dropped = bool(self._gone) and self._map.query == query_mark(self._wanted)
        if is_dropped:
            with suppress(NotStored):  # they are removed again after a restart
                await federated(self._wanted.tenant).entity_maps.drop(self._map.id, self._gone)
        headers = [header for header in result.headers if not _is_page_header(header)]
        if window.count:
            headers.append((_COUNT, str(len(self._ids) - len(self._gone)).encode()))
        headers += self._links(len(some), headers, is_dropped=is_dropped)
        return Response(result.status, result.body, headers)

    def _left(self, limit: int) -> list[str]:
        """Return the first candidates from the offset on that are not known to be gone."""
        left: list[str] = []
        for entity in self._ids[self._window.offset :]:
            if len(left) >= limit:
                break
            if entity not in self._gone:
                left.append(entity)
        return left

    async def _shown(self, some: list[str]) -> tuple[Response, int]:
        """Return the entities in the requested representation, and the number found."""
        ids = some or [_NO_ENTITY]
        plain = _without(self._wanted.parameters, {"offset", "idPattern", PLACE})
        parameters = {**plain, "limit": str(len(ids)), "count": "true"}
        result = await self._perform(self._asking(parameters, ids, self._wanted.document))
        return result, _count_in(result) if result.status < 300 else len(some)

    async def _check(self, ids: list[str]) -> None:
        """Record the candidates that no longer match, unless a source failed."""
        await asyncio.sleep(0)  # serve other requests between the batches of a large map
        parameters = _without(self._wanted.parameters, _UNMARKED - {"local"} | {"idPattern"})
        parameters["limit"] = str(len(ids))
        parameters |= {"lastN": "1"} if self._is_temporal else {"pick": "id"}
        asking = self._asking(parameters, ids, lambda: _unshaped(self._wanted.document()))
        headers = _without(asking.headers, {b"accept", b"prefer"})
        result = await self._perform(derived(asking, headers=headers))
        if result.status < 300 and not _is_warned(result):
            self._gone |= set(ids) - {entity["id"] for entity in orjson.loads(result.body)}

    def _asking(
        self, parameters: Mapping[str, str], ids: list[str], document: Callable[[], Any]
    ) -> RequestContext:
        """Return the request for some ids, in the parameters or in the selectors of a Query."""
        if self._wanted.method == "GET":
            parameters = {**parameters, "id": ",".join(ids)}
            return with_map(self._wanted, entity_map=self._map, parameters=parameters)
        raw = _narrowed(document(), ids)
        if raw is None:
            return with_map(self._wanted, entity_map=self._map, parameters=parameters)
        return with_map(self._wanted, entity_map=self._map, parameters=parameters, raw=raw)

    def _links(
        self, shown: int, headers: list[tuple[bytes, bytes]], *, is_dropped: bool
    ) -> list[tuple[bytes, bytes]]:
        """Return the links to the previous and next pages; `is_dropped`: gone entities have left the map."""
        start, limit = self._window.offset, self._window.limit
        if not limit:
            return []
        end = start
        while shown and end < len(self._ids):
            shown -= self._ids[end] not in self._gone
            end += 1
        has_more = any(entity not in self._gone for entity in self._ids[end:])
        if is_dropped:
            start, end = (
                at - sum(entity_id in self._gone for entity_id in self._ids[:at]) for at in (start, end)
            )
        media_type = next((value for name, value in headers if name == b"content-type"), b"").decode()
        links = [_page_link(self._wanted, max(0, start - limit), "prev", media_type)] if start else []
        return [*links, _page_link(self._wanted, end, "next", media_type)] if has_more else links


def for_the_query(parameters: Mapping[str, str]) -> dict[str, str]:
    """Return the parameters without those of entity maps."""
    plain: dict[str, str] = _without(parameters, MAP_PARAMETERS)
    options = parameters.get("options", "").split(",")
    if MAP_OPTION in options:
        plain["options"] = ",".join(option for option in options if option != MAP_OPTION)
        if not plain["options"]:
            del plain["options"]
    return plain


def query_mark(request: RequestContext) -> str:
    """Return a digest of the query in a request: its filters and its names."""
    parameters = sorted(_without(request.parameters, _UNMARKED).items())
    document = None if request.method == "GET" else _unshaped(request.document())
    parts = [parameters, document, request.headers.get(b"link", b"").decode("latin-1")]
    text = orjson.dumps(parts, option=orjson.OPT_SORT_KEYS)
    return hashlib.blake2b(text, digest_size=8).hexdigest()


def _unshaped(document: Any) -> Any:
    """Return a Query document without the members of the representation."""
    shaping = SHAPING | linked.PARAMETERS | {"ordering", "geometryProperty"}
    return _without(document, shaping) if isinstance(document, Mapping) else document


def _narrowed(document: Any, ids: list[str]) -> bytes | None:
    """Return a Query document limited to some ids; None for an invalid document."""
    selectors = document.get("entities", [{"type": "*"}]) if isinstance(document, Mapping) else None
    if not isinstance(selectors, list) or not all(isinstance(selector, dict) for selector in selectors):
        return None
    narrowed = [
        {"id": ids, **({"type": selector["type"]} if "type" in selector else {})} for selector in selectors
    ]
    return orjson.dumps({**document, "entities": narrowed})


def _ids_in(request: RequestContext) -> set[str] | None:
    """Return the requested ids; None for any."""
    if request.method == "GET":
        text = request.parameter("id")
        return None if text is None else set(text.split(","))
    document = request.document()
    selectors = document.get("entities") if isinstance(document, dict) else None
    result: set[str] = set()
    for selector in selectors if isinstance(selectors, list) else [None]:
        ids = selector.get("id") if isinstance(selector, dict) else None
        if ids is None:
            return None
        result |= {
            entity_id for entity_id in (ids if isinstance(ids, list) else [ids]) if isinstance(entity_id, str)
        }
    return result


def _is_warned(answer: Response) -> bool:
    """Return whether a source failed; code 110 only warns of a cached response."""
    return any(name == b"ngsild-warning" and not value.startswith(b"110") for name, value in answer.headers)


def _count_in(answer: Response) -> int:
    return next((int(value) for name, value in answer.headers if name == _COUNT), 0)


def _is_page_header(header: tuple[bytes, bytes]) -> bool:
    name, value = header
    return name == _COUNT or (name == b"link" and (b'rel="next"' in value or b'rel="prev"' in value))


def _page_link(request: RequestContext, offset: int, relation: str, media_type: str) -> tuple[bytes, bytes]:
    parameters = {**request.parameters, "offset": str(offset)}
    query = "&".join(
        f"{quote(name, safe='')}={quote(value, safe=':,')}" for name, value in parameters.items()
    )
    return b"link", f'<{request.path}?{query}>; rel="{relation}"; type="{media_type}"'.encode()


def _without(parameters: Mapping[Any, Any], names: Any) -> dict[Any, Any]:
    return {name: value for name, value in parameters.items() if name not in names}
