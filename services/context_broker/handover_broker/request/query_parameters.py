"""Query parameters of a request, converted to a selection, a view and a page.

Clauses 6.3.7 (representation), 6.3.10 (pagination) and 6.4.3.2 (query parameters).
"""

from collections.abc import Mapping
from typing import Final
from urllib.parse import quote

from handover_broker.model.context import Context, link_header
from handover_broker.model.entity_parser import DEFAULT_INSTANCE, expand
from handover_broker.model.problems import bad_request_data, invalid_request, too_many_results
from handover_broker.model.representation.language import preferences
from handover_broker.model.representation.projection import read_projection
from handover_broker.model.representation.rendering import Form, View
from handover_broker.model.validation import require_name, require_uri, shown
from handover_broker.query import geo_query, pages
from handover_broker.query.pages import PLACE, Window
from handover_broker.query.parameters import Use, names_for
from handover_broker.query.patterns import pattern
from handover_broker.query.scope_query import scope_query
from handover_broker.query.selection import Selection, compiled
from handover_broker.query.type_selection import type_selection
from handover_broker.request.geojson_parameters import place_of
from handover_broker.request.request_context import RequestContext

DEFAULT_LIMIT: Final = 20
MAX_LIMIT: Final = 1000
VIEW_PARAMETERS: Final = names_for(Use.VIEW)
PAGE_PARAMETERS: Final = names_for(Use.PAGE)
WALK_PARAMETERS: Final = names_for(Use.PAGE | Use.POSITION)
"""Parameters of pages that are linked by positions in an order."""
LINK_PARAMETERS: Final = names_for(Use.LINKS)
MAP_PARAMETERS: Final = names_for(Use.MAP)
"""Parameters of a query that is answered with an entity map."""
QUERY_PARAMETERS: Final = names_for(
    Use.VIEW | Use.PAGE | Use.POSITION | Use.LINKS | Use.ORDER | Use.GEO | Use.SELECTION
)
_SYSTEM: Final = frozenset({"id", "type", "scope", "createdAt", "modifiedAt", "deletedAt", "expiresAt"})
"""Attributes of every entity: requiring one does not narrow a query (clause 5.7.2.4)."""

_FORMS: Final = {
    "normalized": Form.NORMALIZED,
    "concise": Form.CONCISE,
    "keyValues": Form.KEY_VALUES,
    "simplified": Form.KEY_VALUES,
}
_OPTIONS: Final = frozenset({*_FORMS, "sysAttrs", "count"})


WHOLE: Final = View()
"""The default view, which most requests use."""


def options_of(request: RequestContext, allowed: frozenset[str] = _OPTIONS) -> set[str]:
    """Return the parameter `options` as a set; raise a problem for an unknown one."""
    text = request.parameter("options")
    if not text:
        return set()
    options = set(text.split(","))
    if unknown := sorted(options - allowed):
        raise invalid_request(f"options has no {shown(unknown[0])} here; use {', '.join(sorted(allowed))}")
    return options


def names_of(text: str | None, context: Context) -> frozenset[str] | None:
    """Return a comma-separated list of attribute names as IRIs."""
    if text is None:
        return None
    names = [expand(require_name(name, "a name in attrs"), context.terms) for name in text.split(",")]
    return frozenset(names)


def view_of(request: RequestContext, context: Context) -> View:
    """Return the requested view of entities."""
    if not request.parameters:
        return WHOLE
    options = options_of(request)
    forms = {_FORMS[option] for option in options if option in _FORMS}
    wanted = request.parameter("format")
    if wanted is not None:
        if wanted not in _FORMS:
            raise invalid_request(f"format is one of {', '.join(_FORMS)}, not {shown(wanted)}")
        forms = {_FORMS[wanted]}  # it precedes the options (clause 6.3.7)
    if len(forms) > 1:
        raise invalid_request(f"more than one form is requested ({', '.join(sorted(forms))}); choose one")
    form = forms.pop() if forms else Form.NORMALIZED
    attrs, pick, omit = (request.parameter(name) for name in ("attrs", "pick", "omit"))
    if attrs is not None and (pick is not None or omit is not None):
        raise bad_request_data(
            "attrs goes together with neither pick nor omit; name attributes in one of them"
        )
    if request.parameter("geometryProperty") is not None:
        place_of(request, context)  # an invalid one is refused before the query runs
    languages = request.parameter("lang")
    return View(
        form,
        "sysAttrs" in options,
        names_of(attrs, context),
        read_projection(pick, omit, context.terms),
        None if languages is None else preferences(languages),
        datasets_of(request.parameter("datasetId")),
    )


def datasets_of(text: str | None) -> frozenset[str | None] | None:
    """Return a comma-separated list of datasetIds, with None for `@none`, the default instance."""
    if text is None:
        return None
    return frozenset(
        None if dataset == DEFAULT_INSTANCE else require_uri(dataset, "a datasetId in the query")
        for dataset in text.split(",")
    )


def window_of(request: RequestContext, options: frozenset[str] = _OPTIONS, mark: int = 0) -> Window:
    """Return the requested page; `mark` identifies the order of its position."""
    offset = _whole_number(request, "offset", 0)
    limit = _whole_number(request, "limit", DEFAULT_LIMIT)
    if limit > MAX_LIMIT:
        raise too_many_results(f"limit is at most {MAX_LIMIT}, not {limit}; request page by page with offset")
    count = request.flag("count") or "count" in options_of(request, options)
    if limit == 0 and not count:
        raise bad_request_data("limit=0 returns nothing; add count=true to get the number")
    place = request.parameter(PLACE)
    return Window(offset, limit, count, None if place is None else pages.place_of(place, mark))


def selection_of(
    parameters: Mapping[str, str], context: Context, any_of: tuple[Selection, ...] = ()
) -> Selection:
    """Return the selection in query parameters (clauses 4.9, 4.10, 4.17, 4.19 and 5.7.2.4).

    If `any_of` is not empty, entities have to match one of its selections too. Raises a problem (400) for an
    invalid parameter, and for a query that is too broad: ids alone do not narrow it (clauses 5.7.2.4,
    5.7.4.4).
    """
    ids, wanted, types, q = (parameters.get(name) for name in ("id", "idPattern", "type", "q"))
    expand_name = context.terms.expand
    scopes, expanded = parameters.get("scopeQ"), _short_names(parameters, "expandValues")
    selection = Selection(
        ids=None
        if ids is None
        else tuple(require_uri(entity_id, "an id in the query") for entity_id in ids.split(",")),
        id_pattern=None if wanted is None else pattern(wanted),
        types=None if types is None else type_selection(types, expand_name),
        attributes=names_of(parameters.get("attrs"), context),
        query=None if q is None else compiled(q, context, expanded),
        scopes=None if scopes is None else scope_query(scopes),
        places=geo_query.geo_query(parameters, expand_name),
        any_of=any_of,
    )
    _short_names(parameters, "jsonKeys")  # values are compared as they are, so there is nothing to expand
    if (csf := parameters.get("csf")) is not None:
        compiled(csf, context, what="csf")
    refuse_too_broad(selection, parameters)
    return selection


def refuse_too_broad(selection: Selection, parameters: Mapping[str, str]) -> None:
    """Raise a problem (400) if the query selects everything, unless it is local."""
    local = parameters.get("local")
    if selection.types is not None and selection.types.is_every and local == "false":
        raise bad_request_data("type=* selects everything here: local=false contradicts it, leave it out")
    attributes = parameters.get("attrs", "").split(",")
    names = [name for name in ("q", "attrs", "id", "idPattern", "scopeQ") if parameters.get(name)]
    narrows = (
        selection.types is not None
        or (selection.attributes is not None and not _SYSTEM.issuperset(attributes))
        or (selection.query is not None and selection.query.names_attributes)
        or selection.places is not None
        or bool(selection.any_of)
    )
    if not narrows and local != "true":
        others = [name for name in ("type", "attrs", "q", "georel") if name not in names]
        has_times = not {"q", "attrs"}.isdisjoint(names)
        reason = ""
        if names:
            what = "name only what every entity has" if has_times else "do not narrow it down"
            reason = f", because {' and '.join(names)} {what} (clause 5.7.2.4)"
        name_one = " name an attribute of the entities in it, or" if has_times else ""
        raise bad_request_data(
            f"the query is too broad{reason}:{name_one} add {', '.join(others[:-1])} or {others[-1]}, "
            "or local=true to search all entities of this broker"
        )


def _short_names(parameters: Mapping[str, str], name: str) -> frozenset[str]:
    text = parameters.get(name)
    if text is None:
        return frozenset()
    return frozenset(require_name(short_name, f"a name in {name}") for short_name in text.split(","))


def json_headers(context: Context) -> list[tuple[bytes, bytes]]:
    """Return the headers of a response in plain JSON, with its context in a Link header."""
    headers = [(b"content-type", b"application/json")]
    if context.link is not None:
        headers.append((b"link", link_header(context.link).encode()))
    return headers


def page_links(
    request: RequestContext, window: Window, media_type: str, *, more: bool
) -> list[tuple[bytes, bytes]]:
    """Return the Link headers to the previous and the next page."""
    links: list[tuple[bytes, bytes]] = []
    if window.limit == 0:
        return links
    if window.offset > 0:
        links.append(page_link(request, max(0, window.offset - window.limit), "prev", media_type))
    if more:
        links.append(page_link(request, window.offset + window.limit, "next", media_type))
    return links


def page_link(
    request: RequestContext, offset: int, relation: str, media_type: str, place: str | None = None
) -> tuple[bytes, bytes]:
    """Return the Link header to another page; `place` is the position where it starts or ends."""
    parameters = {name: value for name, value in request.parameters.items() if name != PLACE}
    parameters["offset"] = str(offset)
    if place is not None:
        parameters[PLACE] = place
    query = "&".join(
        f"{quote(name, safe='')}={quote(value, safe=':,')}" for name, value in parameters.items()
    )
    return b"link", f'<{request.path}?{query}>; rel="{relation}"; type="{media_type}"'.encode()


def _whole_number(request: RequestContext, name: str, default: int) -> int:
    """Return a query parameter that is a whole number from 0 on."""
    text = request.parameter(name)
    if text is None:
        return default
    if not (text.isascii() and text.isdigit() and len(text) <= 12):
        raise bad_request_data(f"{name} is a whole number from 0 on, not {shown(text)}")
    return int(text)
