"""RIHS01: the hash with which two ROS 2 programs compare their definitions of a type (REP-2016).

It is the SHA-256 of the type's description as JSON: its fields, and the fields of all types that it contains.
"""

import hashlib
import json
from collections.abc import Callable
from typing import Any

from handover_ros.types.definition import Definition, FieldType, Many

_TYPE_IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    # In ROS 2 a char of a .msg file is a uint8 already when the type is hashed.
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
_MESSAGE, _BOUNDED_STRING, _BOUNDED_WSTRING = 1, 21, 22
_FIXED, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144


def rihs01(type_name: str, definition_of: Callable[[str], Definition]) -> str:
    """Return `RIHS01_` and 64 hexadecimal digits; `definition_of` returns definitions by name."""
    whole = description(type_name, definition_of)
    return f"RIHS01_{hashlib.sha256(json.dumps(whole).encode()).hexdigest()}"


def description(type_name: str, definition_of: Callable[[str], Definition]) -> dict[str, Any]:
    """Return the description of a type (type_description_interfaces/msg/TypeDescription) without defaults."""
    described: dict[str, dict[str, Any]] = {}

    def describe(name: str) -> None:
        if name in described:
            return
        described[name] = {}
        definition = definition_of(name)
        fields = [_field(field.name, field.type) for field in definition.fields]
        if not fields:
            fields = [_field("structure_needs_at_least_one_member", FieldType("uint8"))]
        described[name] = {"type_name": name, "fields": fields}
        for field in definition.fields:
            if field.type.is_message:
                describe(field.type.base)

    describe(type_name)
    return {
        "type_description": described[type_name],
        "referenced_type_descriptions": [described[name] for name in sorted(described) if name != type_name],
    }


def _field(name: str, kind: FieldType) -> dict[str, Any]:
    if kind.is_message:
        number = _MESSAGE
    elif kind.text_bound:
        number = _BOUNDED_WSTRING if kind.base == "wstring" else _BOUNDED_STRING
    else:
        number = _TYPE_IDS[kind.base]
    if kind.many is Many.FIXED:
        number += _FIXED
    elif kind.many is Many.SEQUENCE:
        number += _BOUNDED_SEQUENCE if kind.size else _SEQUENCE
    return {
        "name": name,
        "type": {
            "type_id": number,
            "capacity": kind.size,
            "string_capacity": kind.text_bound,
            "nested_type_name": kind.base if kind.is_message else "",
        },
    }
