"""The data type Query (clause 5.2.23), converted to query parameters and selectors."""

from collections.abc import Callable
from typing import Any, Final

import orjson

from handover_broker.model.context import Context
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_uri, shown
from handover_broker.query.parameters import KIND_BY_MEMBER, ValueKind
from handover_broker.query.patterns import pattern
from handover_broker.query.q_grammar import readable
from handover_broker.query.selection import Selection
from handover_broker.query.type_selection import type_selection

MAX_SELECTORS: Final = 1000
"""Maximum entity selectors in one query."""

TEMPORAL: Final = frozenset({"temporalQ", "aggrParams"})
"""Members of temporal queries only."""


def query_parameters(document: Any, beside: frozenset[str] = frozenset()) -> dict[str, str]:
    """Return the query parameters that correspond to a Query document.

    Several entity selectors have no such parameters; `selectors_of` returns them. `beside` are members that
    the caller reads itself. Raises a problem (400) that names the fault.
    """
    if not isinstance(document, dict) or document.get("type", "Query") != "Query":
        raise bad_request_data('the body is an object with "type": "Query"')
    parameters: dict[str, str] = {}
    for name, value in document.items():
        if name in {"type", "@context", "entities"} or name in beside:
            continue
        read = _READERS.get(name)
        if name in TEMPORAL:
            raise bad_request_data(f'"{name}" belongs to temporal/entityOperations/query; leave it out here')
        if read is None:
            raise bad_request_data(f"a Query has no member {shown(name)}; leave it out")
        parameters.update(read(name, value))
    selectors = _selectors(document)
    if len(selectors) == 1:
        parameters.update(_selector_parameters(selectors[0]))
    return parameters


def selectors_of(document: Any, context: Context) -> tuple[Selection, ...]:
    """Return the selections of several entity selectors (clause 5.2.33); an entity has to match one of them.

    A single one is in `query_parameters`. Raises a problem (400) that names the fault.
    """
    selectors = _selectors(document)
    if len(selectors) < 2:
        return ()
    return tuple(_selection(_selector_parameters(selector), context) for selector in selectors)


def _selectors(document: Any) -> list[Any]:
    selectors = document.get("entities", [])
    if not isinstance(selectors, list) or ("entities" in document and not selectors):
        raise bad_request_data('"entities" is a list with at least one selector such as {"type": "Task"}')
    if len(selectors) > MAX_SELECTORS:
        raise bad_request_data(
            f'"entities" has {len(selectors)} selectors; {MAX_SELECTORS} are taken at once'
        )
    return selectors


def _selector_parameters(selector: Any) -> dict[str, str]:
    if not isinstance(selector, dict) or not isinstance(selector.get("type"), str):
        raise bad_request_data(
            f'an entity selector is an object with a "type" (* for every one), not {shown(selector)}'
        )
    if unknown := sorted(set(selector) - {"id", "idPattern", "type"}):
        raise bad_request_data(f"an entity selector has id, idPattern and type, not {shown(unknown[0])}")
    ids, wanted = selector.get("id"), selector.get("idPattern")
    if wanted is not None and not isinstance(wanted, str):
        raise bad_request_data(f"idPattern is text, not {shown(wanted)}")
    if ids is None:
        return selector
    listed = ids if isinstance(ids, list) and ids else [ids]
    ids = ",".join(require_uri(entity_id, "the id of an entity selector") for entity_id in listed)
    # An id takes precedence over a pattern (clause 5.2.33).
    return {"id": ids, "type": selector["type"]}


def _selection(parameters: dict[str, str], context: Context) -> Selection:
    ids, wanted = parameters.get("id"), parameters.get("idPattern")
    return Selection(
        ids=None if ids is None else tuple(ids.split(",")),
        id_pattern=None if wanted is None else pattern(wanted),
        types=type_selection(parameters["type"], context.terms.expand, "the type of an entity selector"),
    )


def _text(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, str):
        raise bad_request_data(f'"{name}" is text, not {shown(value)}')
    return {name: readable(value) if name in {"q", "csf"} else value}


def _texts(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, list) or not value or not all(isinstance(text, str) and text for text in value):
        raise bad_request_data(f'"{name}" is a list with at least one text, not {shown(value)}')
    return {name: ",".join(value)}


def _names(name: str, value: Any) -> dict[str, str]:
    # The standard has these as text with commas; a list is accepted too.
    return _texts(name, value) if isinstance(value, list) else _text(name, value)


def _level(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, int) or isinstance(value, bool):
        raise bad_request_data(f'"{name}" is a whole number from 1 on, not {shown(value)}')
    return {name: str(value)}


def _flag(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, bool):
        raise bad_request_data(f'"{name}" is true or false, not {shown(value)}')
    return {name: "true" if value else "false"}


def _place(name: str, value: Any) -> dict[str, str]:
    return _members(name, value, {"georel": "georel", "geometry": "geometry", "coordinates": "coordinates",
                                  "geoproperty": "geoproperty"})  # fmt: skip


def _order(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, dict) or "orderBy" not in value:
        raise bad_request_data(f'"{name}" is an object such as {{"orderBy": ["name", "age;desc"]}}')
    if not isinstance(value.get("coordinates", []), list):
        raise bad_request_data(f"{name}.coordinates is a list, not {shown(value['coordinates'])}")
    rest = {member: content for member, content in value.items() if member != "orderBy"}
    names = {"coordinates": "orderFrom", "geometry": "orderGeometry", "collation": "collation"}
    return _texts("orderBy", value["orderBy"]) | _members(name, rest, names)


def _members(what: str, content: Any, names: dict[str, str]) -> dict[str, str]:
    """Return the members of an object as the parameters of these names."""
    if not isinstance(content, dict):
        raise bad_request_data(f'"{what}" is an object with {", ".join(names)}, not {shown(content)}')
    parameters: dict[str, str] = {}
    for member, value in content.items():
        if member not in names:
            raise bad_request_data(f"{what} has no member {shown(member)}; leave it out")
        if member == "coordinates" and isinstance(value, list):
            parameters[names[member]] = orjson.dumps(value).decode()
        else:
            parameters |= {names[member]: _text(f"{what}.{member}", value)[f"{what}.{member}"]}
    return parameters


_READER_BY_KIND: Final[dict[ValueKind, Callable[[str, Any], dict[str, str]]]] = {
    ValueKind.TEXT: _text,
    ValueKind.LIST: _texts,
    ValueKind.NAMES: _names,
    ValueKind.FLAG: _flag,
    ValueKind.NUMBER: _level,
    ValueKind.GEO: _place,
    ValueKind.ORDER: _order,
}
_READERS: Final = {member: _READER_BY_KIND[kind] for member, kind in KIND_BY_MEMBER.items()}
