"""How readers ask: the query parameters of a request made into a selection, a view and a page.

Clauses 6.3.7 (representation), 6.3.10 (pagination) and 6.4.3.2 (query parameters).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final
from urllib.parse import quote

from services.context_broker.contexts import Context
from services.context_broker.entity import Entity
from services.context_broker.exchange import GEO_JSON, JSON_LD, Answer, Exchange
from services.context_broker.geojson import (
    OFFERED,
    collection_body,
    feature,
    feature_body,
    has_context_in_body,
    place_of,
)
from services.context_broker.intake import DEFAULT_INSTANCE, expand
from services.context_broker.language import preferences
from services.context_broker.notifier import link
from services.context_broker.patterns import pattern
from services.context_broker.problems import bad_request_data, invalid_request, too_many_results
from services.context_broker.projection import read_projection
from services.context_broker.rendering import Form, View, rendered, with_context
from services.context_broker.selection import Page, Selection, compiled
from services.context_broker.subscriptions import type_names
from services.context_broker.words import require_name, require_uri, shown

DEFAULT_LIMIT: Final = 20
LARGEST_LIMIT: Final = 1000
VIEW_PARAMETERS: Final = frozenset(
    {"options", "format", "attrs", "pick", "omit", "lang", "datasetId", "geometryProperty", "local"}
)
PAGE_PARAMETERS: Final = frozenset({"limit", "offset", "count", "options", "local"})
QUERY_PARAMETERS: Final = (
    VIEW_PARAMETERS | PAGE_PARAMETERS | {"id", "idPattern", "type", "q", "csf", "splitEntities"}
)

_FORMS: Final = {
    "normalized": Form.NORMALIZED,
    "concise": Form.CONCISE,
    "keyValues": Form.KEY_VALUES,
    "simplified": Form.KEY_VALUES,
}
_OPTIONS: Final = frozenset({*_FORMS, "sysAttrs", "count"})


@dataclass(frozen=True, slots=True)
class Window:
    """Which piece of the hits is wanted."""

    offset: int
    limit: int
    count: bool


def options_of(exchange: Exchange, known: frozenset[str] = _OPTIONS) -> set[str]:
    """Return the parameter `options` as a set; raise a problem for one that is not known."""
    given = exchange.parameter("options")
    if not given:
        return set()
    options = set(given.split(","))
    if unknown := sorted(options - known):
        raise invalid_request(f"options has no {shown(unknown[0])} here; it knows {', '.join(sorted(known))}")
    return options


def names_of(given: str | None, context: Context) -> frozenset[str] | None:
    """Return a comma list of attribute names as IRIs."""
    if given is None:
        return None
    names = [expand(require_name(name, "a name in attrs"), context.terms) for name in given.split(",")]
    return frozenset(names)


def view_of(exchange: Exchange, context: Context) -> View:
    """Return how the asker wants entities."""
    options = options_of(exchange)
    forms = {_FORMS[one] for one in options if one in _FORMS}
    wanted = exchange.parameter("format")
    if wanted is not None:
        if wanted not in _FORMS:
            raise invalid_request(f"format is one of {', '.join(_FORMS)}, not {shown(wanted)}")
        forms.add(_FORMS[wanted])
    if len(forms) > 1:
        raise invalid_request(f"more than one form is asked for ({', '.join(sorted(forms))}); choose one")
    form = forms.pop() if forms else Form.NORMALIZED
    attrs, pick, omit = (exchange.parameter(name) for name in ("attrs", "pick", "omit"))
    if attrs is not None and (pick is not None or omit is not None):
        raise bad_request_data(
            "attrs goes together with neither pick nor omit; name attributes in one of them"
        )
    if exchange.parameter("geometryProperty") is not None:
        place_of(exchange, context)  # a fault in it is told before anything is looked for
    languages = exchange.parameter("lang")
    return View(
        form,
        "sysAttrs" in options,
        names_of(attrs, context),
        read_projection(pick, omit, context.terms),
        None if languages is None else preferences(languages),
        datasets_of(exchange.parameter("datasetId")),
    )


def datasets_of(given: str | None) -> frozenset[str | None] | None:
    """Return a comma list of datasetIds, with None for `@none`, the default instance."""
    if given is None:
        return None
    return frozenset(
        None if one == DEFAULT_INSTANCE else require_uri(one, "a datasetId in the query")
        for one in given.split(",")
    )


def window_of(exchange: Exchange, options: frozenset[str] = _OPTIONS) -> Window:
    """Return which page the asker wants."""
    offset = _whole_number(exchange, "offset", 0)
    limit = _whole_number(exchange, "limit", DEFAULT_LIMIT)
    if limit > LARGEST_LIMIT:
        raise too_many_results(f"limit is at most {LARGEST_LIMIT}, not {limit}; ask page by page with offset")
    count = exchange.flag("count") or "count" in options_of(exchange, options)
    if limit == 0 and not count:
        raise bad_request_data("limit=0 asks for nothing; add count=true to learn how many there are")
    return Window(offset, limit, count)


def selection_of(parameters: Mapping[str, str], context: Context) -> Selection:
    """Return which entities are asked for by query parameters."""
    if not any(parameters.get(name) for name in ("type", "id", "attrs", "q")):
        raise bad_request_data("a query is too broad without type, id, attrs or q; add one of them")
    ids, wanted, types = parameters.get("id"), parameters.get("idPattern"), parameters.get("type")
    q = parameters.get("q")
    return Selection(
        ids=None if ids is None else tuple(require_uri(one, "an id in the query") for one in ids.split(",")),
        id_pattern=None if wanted is None else pattern(wanted),
        types=None if types is None else tuple(type_names(types, context)),
        attributes=names_of(parameters.get("attrs"), context),
        query=None if q is None else compiled(q, context),
    )


def entity_answer(exchange: Exchange, entity: Entity, context: Context, view: View) -> Answer:
    """Return one entity as an answer."""
    accept = exchange.accept(OFFERED)
    if accept == GEO_JSON:
        one = feature(entity, context.terms, view, place_of(exchange, context))
        in_body = has_context_in_body(exchange)
        return Answer(200, feature_body(one, context, with_context=in_body), _geo_headers(context, in_body))
    text = rendered(entity, context, view)
    if accept == JSON_LD:
        return Answer(200, with_context(text, context), [(b"content-type", JSON_LD.encode())])
    return Answer(200, text, json_headers(context))


def entities_answer(exchange: Exchange, page: Page, window: Window, context: Context, view: View) -> Answer:
    """Return a page of entities as an answer, with links to its neighbours."""
    accept = exchange.accept(OFFERED)
    if accept == GEO_JSON:
        place, in_body = place_of(exchange, context), has_context_in_body(exchange)
        features = (feature(entity, context.terms, view, place) for entity in page.entities)
        body, headers = (
            collection_body(features, context, with_context=in_body),
            _geo_headers(context, in_body),
        )
    else:
        texts: Iterable[bytes] = (rendered(entity, context, view) for entity in page.entities)
        if accept == JSON_LD:
            texts = (with_context(text, context) for text in texts)
            headers = [(b"content-type", JSON_LD.encode())]
        else:
            headers = json_headers(context)
        body = b"[" + b",".join(texts) + b"]"
    if page.total is not None:
        headers.append((b"ngsild-results-count", str(page.total).encode()))
    if exchange.method == "GET":
        headers += page_links(exchange, window, accept, more=page.more)
    return Answer(200, body, headers)


def _geo_headers(context: Context, in_body: bool) -> list[tuple[bytes, bytes]]:
    headers = [(b"content-type", GEO_JSON.encode())]
    if not in_body and context.link is not None:
        headers.append((b"link", link(context.link).encode()))
    return headers


def json_headers(context: Context) -> list[tuple[bytes, bytes]]:
    """Return the headers of an answer in plain JSON, its context named in a Link."""
    headers = [(b"content-type", b"application/json")]
    if context.link is not None:
        headers.append((b"link", link(context.link).encode()))
    return headers


def page_links(
    exchange: Exchange, window: Window, media_type: str, *, more: bool
) -> list[tuple[bytes, bytes]]:
    """Return the Link headers to the page before and after."""
    links: list[tuple[bytes, bytes]] = []
    if window.limit == 0:
        return links
    if window.offset > 0:
        links.append(_page_link(exchange, max(0, window.offset - window.limit), "prev", media_type))
    if more:
        links.append(_page_link(exchange, window.offset + window.limit, "next", media_type))
    return links


def _page_link(exchange: Exchange, offset: int, relation: str, media_type: str) -> tuple[bytes, bytes]:
    parameters = {**exchange.parameters, "offset": str(offset)}
    query = "&".join(
        f"{quote(name, safe='')}={quote(value, safe=':,')}" for name, value in parameters.items()
    )
    return b"link", f'<{exchange.path}?{query}>; rel="{relation}"; type="{media_type}"'.encode()


def _whole_number(exchange: Exchange, name: str, default: int) -> int:
    given = exchange.parameter(name)
    if given is None:
        return default
    if not (given.isascii() and given.isdigit() and len(given) <= 12):
        raise bad_request_data(f"{name} is a whole number from 0 on, not {shown(given)}")
    return int(given)
