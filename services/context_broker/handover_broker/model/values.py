"""Validation of values by kind of attribute.

Clauses 4.5.2 to 4.5.24 and 4.6. NULL marks deletions and is checked elsewhere.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

import orjson

from handover_broker.model.entity import NULL, Terms
from handover_broker.model.geometry import fault_of
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import is_short_uri, require_uri, shown

_NULL_LIST: Final = [NULL]

Said = Callable[[str, Any, Terms], Any]


def _value(name: str, value: Any, _: Terms) -> Any:
    if value is None:
        raise bad_request_data(
            f"attribute {shown(name)} is null, which NGSI-LD cannot store; leave it out, or send {NULL} in a "
            "change to delete it"
        )
    return value


def _object(name: str, value: Any, _: Terms) -> Any:
    if value.__class__ is str and is_short_uri(value):
        return value
    what = f"the object of relationship {shown(name)}"
    if isinstance(value, list) and value:
        return [_linked(target, what) for target in value]
    return require_uri(value, what)


def _linked(value: Any, what: str) -> str:
    if value == NULL:
        raise bad_request_data(f"{what} has {NULL} in its list; send the list without the elements to delete")
    return require_uri(value, what)


def _geometry(name: str, value: Any, _: Terms) -> Any:
    if isinstance(value, str) and value != NULL:
        value = _decoded(name, value)
    fault = None if value == NULL else fault_of(value)
    if fault:
        raise bad_request_data(f"attribute {shown(name)} is a GeoProperty: {fault}")
    return value


def _decoded(name: str, text: str) -> Any:
    """Return a geometry that was sent as a JSON string (clause 4.7.2)."""
    try:
        return orjson.loads(text)
    except orjson.JSONDecodeError:
        raise bad_request_data(
            f"attribute {shown(name)} is a GeoProperty: the text {shown(text)} is not a geometry in JSON"
        ) from None


def _language_map(name: str, value: Any, _: Terms) -> Any:
    if value == NULL:
        return value
    if (
        not isinstance(value, dict)
        or not value
        or "" in value
        or not all(_is_wording(wording) for wording in value.values())
    ):
        raise bad_request_data(
            f'the languageMap of {shown(name)} maps language tags to text, for example {{"en": "gripper"}}'
        )
    return value


def _is_wording(value: Any) -> bool:
    return isinstance(value, str) or (
        isinstance(value, list) and all(isinstance(word, str) for word in value)
    )


def _json(name: str, value: Any, _: Terms) -> Any:
    if value != NULL and not isinstance(value, dict | list):
        raise bad_request_data(
            f"the json of {shown(name)} is an object or a list, not {shown(value)}; plain values belong into "
            'the "value" of a Property'
        )
    return value


def _vocab(name: str, value: Any, terms: Terms) -> Any:
    words = value if isinstance(value, list) else [value]
    if not words or not all(isinstance(word, str) and word for word in words):
        raise bad_request_data(f"the vocab of {shown(name)} is a term or a list of terms, not {shown(value)}")
    if value == NULL:
        return value
    return [terms.expand(word) for word in words] if isinstance(value, list) else terms.expand(value)


def _value_list(name: str, value: Any, _: Terms) -> Any:
    if value == _NULL_LIST:  # this deletes a whole list (clause 4.5.21)
        return NULL
    if value != NULL and not isinstance(value, list):
        raise bad_request_data(f"the valueList of {shown(name)} must be a list, not {shown(value)}")
    return value


def _object_list(name: str, value: Any, _: Terms) -> Any:
    if value in (NULL, _NULL_LIST, [{"object": NULL}]):
        return NULL
    if not isinstance(value, list):
        raise bad_request_data(f"the objectList of {shown(name)} must be a list, not {shown(value)}")
    what = f"the objectList of {shown(name)}"
    return [
        {"object": _linked(target.get("object") if isinstance(target, dict) else target, what)}
        for target in value
    ]


SAID: Final[Mapping[str, Said]] = {
    "Property": _value,
    "Relationship": _object,
    "GeoProperty": _geometry,
    "LanguageProperty": _language_map,
    "JsonProperty": _json,
    "VocabProperty": _vocab,
    "ListProperty": _value_list,
    "ListRelationship": _object_list,
}
"""By kind of attribute: validates its value, and converts it to the stored form."""
