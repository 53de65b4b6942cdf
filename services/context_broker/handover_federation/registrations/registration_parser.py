"""Reads registrations: validates documents, expands their names, and makes them ready for matching.

Clauses 5.2.9 (the document), 5.9.2.4 (what is refused) and 4.3.6.3 (requirements for exclusive ones).
"""

from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.entity_parser import DEFAULT_INSTANCE, expand, read_attribute
from handover_broker.model.geometry import fault_of
from handover_broker.model.owner import Owner
from handover_broker.model.problems import bad_request_data
from handover_broker.model.secrets import kept_members, require_secrets_again, without_secrets
from handover_broker.model.stored_documents import refuse_null
from handover_broker.model.validation import (
    TENANT,
    duration_s,
    moment,
    require_future,
    require_name,
    require_scope,
    require_time,
    require_uri,
    shown,
)
from handover_broker.query.patterns import pattern
from handover_federation.registrations import operation_names as names
from handover_federation.registrations.registration import (
    PROPERTIES,
    SECRETS,
    TYPE,
    EntityInfo,
    Information,
    Interval,
    Management,
    Mode,
    Registration,
    root_of,
)

PLACES: Final = ("location", "observationSpace", "operationSpace")
_TEXTS: Final = ("registrationName", "description", "tenant", "contextSourceAlias", "refreshRate")
_PLAIN: Final = frozenset(
    {"id", "registrationName", "description", "information", "tenant", "observationInterval",
     "managementInterval", *PLACES, "expiresAt", "endpoint", "contextSourceInfo", "contextSourceAlias",
     "scope", "mode", "operations", "refreshRate", "management", "datasetId"}
)  # fmt: skip
_FROM_THE_BROKER: Final = frozenset(
    {"createdAt", "modifiedAt", "deletedAt", "status", "timesSent", "timesFailed", "lastSuccess",
     "lastFailure"}
)  # fmt: skip
_ATTRIBUTE_LISTS: Final = ("propertyNames", "relationshipNames")


def kept_document(given: Any, context: Context, *, is_change: bool = False) -> dict[str, Any]:
    """Return the document to store for a registration, or for an update, from a client's document.

    Members that the standard does not name are Context Source Properties, which filters (csf) can use. A null
    stays as None: in an update it deletes the member.
    """
    if not isinstance(given, Mapping):
        raise bad_request_data(f"a registration is a JSON object, not {shown(given)}")
    if given.get("type", TYPE) != TYPE:
        raise bad_request_data(f'the type of a registration is "{TYPE}", not {shown(given["type"])}')
    refuse_null(given, "a registration", deleting=1 if is_change else 0)
    document: dict[str, Any] = {}
    properties: dict[str, Any] = {}
    for name, value in given.items():
        if name in _PLAIN:
            document[name] = value
        elif name not in _FROM_THE_BROKER and name not in {"type", "@context"}:
            properties[expand(require_name(name, "a property of the registration"), context.terms)] = value
    if document.get("information") is not None:
        document["information"] = _kept_information(document["information"], context)
    if properties:
        document[PROPERTIES] = properties
    return document


def updated_document(before: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document after an update (clause 5.9.3): members are replaced, null deletes them."""
    if change.get("id", before["id"]) != before["id"]:
        raise bad_request_data(
            f"the id of a registration cannot be changed; leave it out or say {before['id']}"
        )
    change = kept_members(change, before, *SECRETS)
    after = {**before, **change, "id": before["id"]}
    require_secrets_again(after, before, change, *SECRETS)
    after[PROPERTIES] = _without_null({**before.get(PROPERTIES, {}), **change.get(PROPERTIES, {})})
    return _without_null(after)


def registration(document: Mapping[str, Any], context: Context) -> Registration:
    """Return the registration of a stored document; raises a problem (400) that names an invalid member."""
    information = document.get("information")
    if not isinstance(information, list) or not information:
        raise bad_request_data(
            'a registration has "information", a list with at least one piece such as '
            '{"entities": [{"type": "Task"}]}; add it'
        )
    _check_texts(document)
    mode = _mode(document.get("mode", "inclusive"))
    pieces = tuple(_information(one) for one in information)
    observed = _interval(document, "observationInterval")
    managed = _interval(document, "managementInterval")
    operations = _operations(document.get("operations"), mode, is_temporal=bool(observed or managed))
    _check_mode(mode, pieces, operations)
    return Registration(
        id=document["id"],
        document=document,
        context=context,
        information=pieces,
        mode=mode,
        operations=operations,
        endpoint=_endpoint(document.get("endpoint")),
        tenant=document.get("tenant", ""),
        alias=document.get("contextSourceAlias"),
        source_info=_source_info(document.get("contextSourceInfo", [])),
        scopes=_scopes(document.get("scope", [])),
        places={name: _place(document[name], name) for name in PLACES if name in document},
        observed=observed,
        managed=managed,
        datasets=_datasets(document.get("datasetId")),
        management=_management(document.get("management", {})),
        expires_at_s=_expiry(document.get("expiresAt")),
        described=_described(document, context),
        owner=Owner.restored(document),
    )


def refuse_past(document: Mapping[str, Any]) -> None:
    """Raise a problem (400) if a new registration has already expired."""
    if "expiresAt" in document:
        require_future(document["expiresAt"], '"expiresAt"')


def _without_null(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in document.items() if value is not None}


def _kept_information(given: Any, context: Context) -> list[dict[str, Any]]:
    if not isinstance(given, list) or not given:
        raise bad_request_data(f'"information" is a list with at least one object, not {shown(given)}')
    return [_kept_piece(one, context) for one in given]


def _kept_piece(given: Any, context: Context) -> dict[str, Any]:
    known = {"entities", *_ATTRIBUTE_LISTS}
    if not isinstance(given, Mapping) or not given or not known.issuperset(given):
        raise bad_request_data(
            f"a piece of information has entities, propertyNames or relationshipNames, not {shown(given)}"
        )
    piece = {
        name: [expand(require_name(one, f"a name in {name}"), context.terms) for one in _list(given, name)]
        for name in _ATTRIBUTE_LISTS
        if name in given
    }
    if "entities" in given:
        piece["entities"] = [_kept_entity_info(one, context) for one in _list(given, "entities")]
    return piece


def _list(given: Mapping[str, Any], name: str) -> list[Any]:
    found = given[name]
    if not isinstance(found, list) or not found:
        raise bad_request_data(f'"{name}" is a list with at least one item, not {shown(found)}; leave it out')
    return found


def _kept_entity_info(given: Any, context: Context) -> Any:
    if not isinstance(given, Mapping) or not {"id", "idPattern", "type"}.issuperset(given):
        raise bad_request_data(
            f"an item of entities has a type and maybe an id or an idPattern, not {shown(given)}"
        )
    if "type" not in given:
        raise bad_request_data(f"{shown(dict(given))} in entities has no type; name the type of the entities")
    kinds = given["type"] if isinstance(given["type"], list) else [given["type"]]
    types = [expand(require_name(kind, "a type in entities"), context.terms) for kind in kinds]
    if not types:
        raise bad_request_data("the list of types in entities is empty; name at least one")
    info = {**given, "type": types[0] if len(types) == 1 else types}
    if "id" in info:
        require_uri(info["id"], "an id in entities")
    return info


def _information(stored: Mapping[str, Any]) -> Information:
    attributes = [name for one in _ATTRIBUTE_LISTS for name in stored.get(one, ())]
    return Information(
        tuple(_entity_info(one) for one in stored.get("entities", ())), frozenset(attributes) or None
    )


def _entity_info(stored: Mapping[str, Any]) -> EntityInfo:
    wanted = stored.get("idPattern")
    if wanted is not None and not isinstance(wanted, str):
        raise bad_request_data(f"idPattern is text, not {shown(wanted)}")
    types = stored["type"] if isinstance(stored["type"], list) else [stored["type"]]
    id_pattern = None if wanted is None or "id" in stored else pattern(wanted)  # the id takes precedence
    return EntityInfo(frozenset(types), stored.get("id"), id_pattern)


def _check_texts(document: Mapping[str, Any]) -> None:
    for name in _TEXTS:
        if name in document and (not isinstance(document[name], str) or not document[name]):
            raise bad_request_data(f'"{name}" is text, not {shown(document[name])}')
    if "tenant" in document and not TENANT.fullmatch(document["tenant"]):
        raise bad_request_data(
            f'"tenant" {shown(document["tenant"])} is not a valid tenant name: use A-Z, a-z, 0-9, _ - .'
        )
    if "refreshRate" in document:
        duration_s(document["refreshRate"], '"refreshRate"')


def _mode(given: Any) -> Mode:
    try:
        return Mode[given.upper()]
    except (KeyError, AttributeError):
        known = ", ".join(one.name.lower() for one in Mode)
        raise bad_request_data(f'"mode" is one of {known}, not {shown(given)}') from None


def _operations(given: Any, mode: Mode, *, is_temporal: bool) -> frozenset[str]:
    """Return the single operations; the default depends on the mode and on the intervals."""
    if given is None:
        if mode is Mode.AUXILIARY:
            return names.AUXILIARY_OPERATIONS
        defaults = names.GROUPS[names.DEFAULT_GROUP]
        return defaults | names.TEMPORAL_READING if is_temporal else defaults
    known = names.NAMES | names.GROUPS.keys()
    for one in given if isinstance(given, list) else [given]:
        if not isinstance(one, str) or one not in known:
            raise bad_request_data(
                f'"operations" is a list of operations and groups such as {", ".join(names.GROUPS)}, '
                f"which {shown(one)} is not"
            )
    if not isinstance(given, list) or not given:
        raise bad_request_data(
            '"operations" is a list with at least one operation; leave it out for the default'
        )
    return names.operations_of(given)


def _check_mode(mode: Mode, pieces: tuple[Information, ...], operations: frozenset[str]) -> None:
    if mode is Mode.AUXILIARY and operations - names.AUXILIARY_OPERATIONS:
        raise bad_request_data(
            "an auxiliary source only fills gaps; its operations are retrieveOps, retrieveEntity, queryEntity"
        )
    if mode is not Mode.EXCLUSIVE:
        return
    for piece in pieces:
        if piece.attributes is None:
            raise bad_request_data(
                "an exclusive registration names attributes; add propertyNames or relationshipNames"
            )
        if not piece.entities or any(entity.id is None for entity in piece.entities):
            raise bad_request_data(
                "an exclusive registration is about single entities: each of its entities has an id"
            )


def _endpoint(given: Any) -> str:
    if given is None:
        raise bad_request_data('a registration has an "endpoint" such as http://127.0.0.1:1027; add it')
    uri = require_uri(given, '"endpoint"')
    try:
        parts = urlsplit(uri)
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable or not uri.isascii() or parts.query or parts.fragment:
        raise bad_request_data(
            f'"endpoint" is an address such as http://127.0.0.1:1027 without ? and #, not {shown(uri)}'
        )
    return root_of(uri)


def _source_info(given: Any) -> tuple[tuple[str, str], ...]:
    if not isinstance(given, list):
        raise bad_request_data(
            'contextSourceInfo is a list of objects such as {"key": "X-Cell", "value": "4"}'
        )
    pairs: list[tuple[str, str]] = []
    for pair in given:
        key, value = (pair.get("key"), pair.get("value")) if isinstance(pair, Mapping) else (None, None)
        if not isinstance(key, str) or not isinstance(value, str):
            raise bad_request_data(
                f'each contextSourceInfo has a "key" and a "value" of text, not {shown(pair)}'
            )
        is_token = bool(key) and key.isascii() and key.replace("-", "").replace("_", "").isalnum()
        if not is_token or not (value.isascii() and value.isprintable()):
            raise bad_request_data(f"contextSourceInfo {shown(key)} cannot be a header; use plain characters")
        pairs.append((key, value))
    return tuple(pairs)


def _scopes(given: Any) -> tuple[str, ...]:
    return tuple(require_scope(one) for one in (given if isinstance(given, list) else [given]))


def _datasets(given: Any) -> frozenset[str | None] | None:
    if given is None:
        return None
    if isinstance(given, list) and not given:
        raise bad_request_data('"datasetId" is a list with at least one datasetId; leave it out for all')
    return frozenset(
        None if one == DEFAULT_INSTANCE else require_uri(one, "a datasetId of a registration")
        for one in (given if isinstance(given, list) else [given])
    )


def _place(given: Any, name: str) -> Mapping[str, Any]:
    """Return a geometry; one wrapped into a GeoProperty is accepted too, as in published examples."""
    is_wrapped = isinstance(given, Mapping) and given.get("type") == "GeoProperty"
    geometry = given.get("value") if is_wrapped else given
    fault = fault_of(geometry)
    if fault or not isinstance(geometry, Mapping):
        raise bad_request_data(f'"{name}" of a registration: {fault}')
    return geometry


def _interval(document: Mapping[str, Any], name: str) -> Interval | None:
    given = document.get(name)
    if given is None:
        return None
    if not isinstance(given, Mapping) or "startAt" not in given or not {"startAt", "endAt"}.issuperset(given):
        raise bad_request_data(f'"{name}" has a startAt and maybe an endAt, not {shown(given)}')
    start_s = moment(require_time(given["startAt"], f"startAt of {name}")) or 0.0
    end_s = float("inf")
    if "endAt" in given:
        end_s = moment(require_time(given["endAt"], f"endAt of {name}")) or 0.0
    if end_s < start_s:
        raise bad_request_data(f'"{name}" ends before it starts; exchange startAt and endAt')
    return start_s, end_s


def _management(given: Any) -> Management:
    known = {"localOnly", "cacheDuration", "timeout", "cooldown"}
    if not isinstance(given, Mapping) or not known.issuperset(given):
        raise bad_request_data(
            f'"management" is an object with {", ".join(sorted(known))}, not {shown(given)}'
        )
    local_only = given.get("localOnly", False)
    if not isinstance(local_only, bool):
        raise bad_request_data(f"management.localOnly is true or false, not {shown(local_only)}")
    cache = given.get("cacheDuration")
    timeout_ms, cooldown_ms = (_milliseconds(given, name) for name in ("timeout", "cooldown"))
    return Management(
        local_only=local_only,
        cache_s=0.0 if cache is None else duration_s(cache, "management.cacheDuration"),
        timeout_s=None if timeout_ms is None else timeout_ms / 1000,
        cooldown_s=(cooldown_ms or 0.0) / 1000,
    )


def _milliseconds(given: Mapping[str, Any], name: str) -> float | None:
    value = given.get(name)
    if value is None:
        return None
    if not isinstance(value, int | float) or isinstance(value, bool) or value <= 0:
        raise bad_request_data(f"management.{name} is a number of milliseconds above 0, not {shown(value)}")
    return float(value)


def _expiry(given: Any) -> float:
    if given is None:
        return float("inf")
    return moment(require_time(given, '"expiresAt"')) or 0.0


def _described(document: Mapping[str, Any], context: Context) -> Entity:
    """Return the registration as an entity: its own properties, and its plain members under their IRIs."""
    terms = context.terms
    attributes = {
        name: read_attribute(terms.compact(name), value, terms)
        for name, value in document.get(PROPERTIES, {}).items()
    }
    for name in PLACES:
        if name in document:
            place = _place(document[name], name)
            attributes[expand(name, terms)] = [{"type": "GeoProperty", "value": place}]
    for name in (*_TEXTS, "endpoint", "mode"):
        if isinstance(document.get(name), str):
            text = without_secrets(document[name]) if name == "endpoint" else document[name]
            attributes.setdefault(expand(name, terms), [{"type": "Property", "value": text}])
    return Entity(
        document["id"],
        (expand(TYPE, terms),),
        attributes,
        document.get("createdAt", ""),
        document.get("modifiedAt", ""),
    )
