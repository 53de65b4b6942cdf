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


def kept_document(body: Any, context: Context, *, is_change: bool = False) -> dict[str, Any]:
    """Return the document to store for a registration, or for an update, from a client's document.

    Members that the standard does not name are Context Source Properties, which filters (csf) can use. A null
    stays as None: in an update it deletes the member.
    """
    if not isinstance(body, Mapping):
        raise bad_request_data(f"a registration is a JSON object, not {shown(body)}")
    if body.get("type", TYPE) != TYPE:
        raise bad_request_data(f'the type of a registration is "{TYPE}", not {shown(body["type"])}')
    refuse_null(body, "a registration", deleting=1 if is_change else 0)
    document: dict[str, Any] = {}
    properties: dict[str, Any] = {}
    for name, value in body.items():
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
    pieces = tuple(_information(piece) for piece in information)
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


def _kept_information(information: Any, context: Context) -> list[dict[str, Any]]:
    if not isinstance(information, list) or not information:
        raise bad_request_data(f'"information" is a list with at least one object, not {shown(information)}')
    return [_kept_piece(piece, context) for piece in information]


def _kept_piece(document: Any, context: Context) -> dict[str, Any]:
    members = {"entities", *_ATTRIBUTE_LISTS}
    if not isinstance(document, Mapping) or not document or not members.issuperset(document):
        raise bad_request_data(
            f"a piece of information has entities, propertyNames or relationshipNames, not {shown(document)}"
        )
    piece = {
        name: [
            expand(require_name(listed_name, f"a name in {name}"), context.terms)
            for listed_name in _list(document, name)
        ]
        for name in _ATTRIBUTE_LISTS
        if name in document
    }
    if "entities" in document:
        piece["entities"] = [
            _kept_entity_info(entity_info, context) for entity_info in _list(document, "entities")
        ]
    return piece


def _list(piece: Mapping[str, Any], name: str) -> list[Any]:
    listed = piece[name]
    if not isinstance(listed, list) or not listed:
        raise bad_request_data(
            f'"{name}" is a list with at least one item, not {shown(listed)}; leave it out'
        )
    return listed


def _kept_entity_info(entity_info: Any, context: Context) -> Any:
    if not isinstance(entity_info, Mapping) or not {"id", "idPattern", "type"}.issuperset(entity_info):
        raise bad_request_data(
            f"an item of entities has a type and maybe an id or an idPattern, not {shown(entity_info)}"
        )
    if "type" not in entity_info:
        raise bad_request_data(
            f"{shown(dict(entity_info))} in entities has no type; name the type of the entities"
        )
    kinds = entity_info["type"] if isinstance(entity_info["type"], list) else [entity_info["type"]]
    types = [expand(require_name(kind, "a type in entities"), context.terms) for kind in kinds]
    if not types:
        raise bad_request_data("the list of types in entities is empty; name at least one")
    info = {**entity_info, "type": types[0] if len(types) == 1 else types}
    if "id" in info:
        require_uri(info["id"], "an id in entities")
    return info


def _information(stored: Mapping[str, Any]) -> Information:
    attributes = [name for member in _ATTRIBUTE_LISTS for name in stored.get(member, ())]
    return Information(
        tuple(_entity_info(entity_info) for entity_info in stored.get("entities", ())),
        frozenset(attributes) or None,
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


def _mode(text: Any) -> Mode:
    try:
        return Mode[text.upper()]
    except (KeyError, AttributeError):
        modes = ", ".join(mode.name.lower() for mode in Mode)
        raise bad_request_data(f'"mode" is one of {modes}, not {shown(text)}') from None


def _operations(listed: Any, mode: Mode, *, is_temporal: bool) -> frozenset[str]:
    """Return the single operations; the default depends on the mode and on the intervals."""
    if listed is None:
        if mode is Mode.AUXILIARY:
            return names.AUXILIARY_OPERATIONS
        defaults = names.GROUPS[names.DEFAULT_GROUP]
        return defaults | names.TEMPORAL_READING if is_temporal else defaults
    all_names = names.NAMES | names.GROUPS.keys()
    for name in listed if isinstance(listed, list) else [listed]:
        if not isinstance(name, str) or name not in all_names:
            raise bad_request_data(
                f'"operations" is a list of operations and groups such as {", ".join(names.GROUPS)}, '
                f"which {shown(name)} is not"
            )
    if not isinstance(listed, list) or not listed:
        raise bad_request_data(
            '"operations" is a list with at least one operation; leave it out for the default'
        )
    return names.operations_of(listed)


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


def _endpoint(url: Any) -> str:
    if url is None:
        raise bad_request_data('a registration has an "endpoint" such as http://127.0.0.1:1027; add it')
    uri = require_uri(url, '"endpoint"')
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


def _source_info(listed: Any) -> tuple[tuple[str, str], ...]:
    if not isinstance(listed, list):
        raise bad_request_data(
            'contextSourceInfo is a list of objects such as {"key": "X-Cell", "value": "4"}'
        )
    pairs: list[tuple[str, str]] = []
    for pair in listed:
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


def _scopes(scopes: Any) -> tuple[str, ...]:
    return tuple(require_scope(scope) for scope in (scopes if isinstance(scopes, list) else [scopes]))


def _datasets(datasets: Any) -> frozenset[str | None] | None:
    if datasets is None:
        return None
    if isinstance(datasets, list) and not datasets:
        raise bad_request_data('"datasetId" is a list with at least one datasetId; leave it out for all')
    return frozenset(
        None if dataset == DEFAULT_INSTANCE else require_uri(dataset, "a datasetId of a registration")
        for dataset in (datasets if isinstance(datasets, list) else [datasets])
    )


def _place(place: Any, name: str) -> Mapping[str, Any]:
    """Return a geometry; one wrapped into a GeoProperty is accepted too, as in published examples."""
    is_wrapped = isinstance(place, Mapping) and place.get("type") == "GeoProperty"
    geometry = place.get("value") if is_wrapped else place
    fault = fault_of(geometry)
    if fault or not isinstance(geometry, Mapping):
        raise bad_request_data(f'"{name}" of a registration: {fault}')
    return geometry


def _interval(document: Mapping[str, Any], name: str) -> Interval | None:
    period = document.get(name)
    if period is None:
        return None
    if (
        not isinstance(period, Mapping)
        or "startAt" not in period
        or not {"startAt", "endAt"}.issuperset(period)
    ):
        raise bad_request_data(f'"{name}" has a startAt and maybe an endAt, not {shown(period)}')
    start_s = moment(require_time(period["startAt"], f"startAt of {name}")) or 0.0
    end_s = float("inf")
    if "endAt" in period:
        end_s = moment(require_time(period["endAt"], f"endAt of {name}")) or 0.0
    if end_s < start_s:
        raise bad_request_data(f'"{name}" ends before it starts; exchange startAt and endAt')
    return start_s, end_s


def _management(management: Any) -> Management:
    members = {"localOnly", "cacheDuration", "timeout", "cooldown"}
    if not isinstance(management, Mapping) or not members.issuperset(management):
        raise bad_request_data(
            f'"management" is an object with {", ".join(sorted(members))}, not {shown(management)}'
        )
    local_only = management.get("localOnly", False)
    if not isinstance(local_only, bool):
        raise bad_request_data(f"management.localOnly is true or false, not {shown(local_only)}")
    cache = management.get("cacheDuration")
    timeout_ms, cooldown_ms = (_milliseconds(management, name) for name in ("timeout", "cooldown"))
    return Management(
        local_only=local_only,
        cache_s=0.0 if cache is None else duration_s(cache, "management.cacheDuration"),
        timeout_s=None if timeout_ms is None else timeout_ms / 1000,
        cooldown_s=(cooldown_ms or 0.0) / 1000,
    )


def _milliseconds(management: Mapping[str, Any], name: str) -> float | None:
    value = management.get(name)
    if value is None:
        return None
    if not isinstance(value, int | float) or isinstance(value, bool) or value <= 0:
        raise bad_request_data(f"management.{name} is a number of milliseconds above 0, not {shown(value)}")
    return float(value)


def _expiry(text: Any) -> float:
    if text is None:
        return float("inf")
    return moment(require_time(text, '"expiresAt"')) or 0.0


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
