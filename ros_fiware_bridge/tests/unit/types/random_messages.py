"""Random messages of any type, and their decoded form."""

from typing import Any

import numpy as np
from hypothesis import strategies as st

from handover_ros.types.definition import FLOATS, INTEGER_RANGES, FieldType, Many
from handover_ros.types.type_store import TypeStore


def one(store: TypeStore, kind: FieldType) -> st.SearchStrategy[Any]:
    """Return a strategy for values of `kind`."""
    if kind.is_message:
        return message_of(store, kind.base)
    if kind.base == "string":
        most = kind.text_bound // 4 if kind.text_bound else 8  # a character has up to 4 bytes
        return st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=most)
    if kind.base == "bool":
        return st.booleans()
    if kind.base in FLOATS:
        return st.floats(width=32 if kind.base == "float32" else 64, allow_nan=False)
    return st.integers(*INTEGER_RANGES[kind.base])


def message_of(store: TypeStore, type_name: str) -> st.SearchStrategy[dict[str, Any]]:
    """Return a strategy for messages of a type that `store` knows."""
    parts = {}
    for field in store.definition(type_name).fields:
        kind = field.type
        if kind.many is Many.ONE:
            parts[field.name] = one(store, kind)
        else:
            most = kind.size or 3
            items = st.lists(
                one(store, kind.item), min_size=kind.size if kind.many is Many.FIXED else 0, max_size=most
            )
            parts[field.name] = items.map(bytes) if kind.is_octets else items
    return st.fixed_dictionaries(parts)


def listed(value: Any) -> Any:
    """Return a message with lists instead of arrays."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [listed(item) for item in value]
    return {key: listed(item) for key, item in value.items()} if isinstance(value, dict) else value
