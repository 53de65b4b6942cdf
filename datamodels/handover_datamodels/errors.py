"""Errors of data that do not match the vocabulary."""

from collections.abc import Iterable, Mapping
from typing import Any

_OBJECT_FAULTS = frozenset({"dict_type", "mapping_type"})
"""What pydantic calls a value that is not a JSON object."""


class DataModelError(ValueError):
    """An entity or a context breaks a rule; the message names the thing, the attribute and the rule."""


def explained(kind: str, data: Mapping[str, Any], faults: Iterable[Mapping[str, Any]]) -> str:
    """Return one line for all `faults` (pydantic's) of the entity `data`, which should be a `kind`."""
    described = "; ".join(_described(fault) for fault in faults)
    return f"{data.get('id') or 'an entity without id'} is no valid {kind}: {described}"


def _described(fault: Mapping[str, Any]) -> str:
    path = [str(part) for part in fault["loc"]]
    is_object = fault["type"] in _OBJECT_FAULTS
    rule = "must be a JSON object" if is_object else str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "missing":
        rule = "is required" if len(path) < 2 else f'its member "{path[-1]}" is required'
    if not path:
        return rule
    inside = ".".join(part for part in path[1:] if "[" not in part)
    where = f'attribute "{path[0]}"' + (f" ({inside})" if inside else "")
    return f"{where}: {rule}"
