"""Scaffolding: generates a mapping for a topic with every suitable field, for the user to reduce."""

from collections.abc import Iterator

from handover_ros.graph.qos import PROFILES, Qos
from handover_ros.rules.message_schema import HEADER
from handover_ros.types.definition import FieldType, Many
from handover_ros.types.type_store import TypeStore

MAX_DEPTH = 4
MAX_ATTRIBUTES = 40
MAX_INLINE_FIELDS = 4
"""A message with at most so many fields, all primitive, becomes one attribute."""


def mapping_for(topic: str, type_name: str, qos: Qos | None, store: TypeStore) -> str:
    """Return the text of a mapping for `topic`. Raises `GraphError` if the type is unknown."""
    store.sound(type_name)
    name = topic.strip("/").replace("/", "-").lower()
    device = topic.strip("/").split("/")[0] if "/" in topic.strip("/") else "robot-1"
    lines = [
        f"# Writes the messages of {topic} to attributes of a Device. Remove the attributes that you do not",
        "# need, and adjust the rate; `handover bridge check FILE` describes what the mapping does.",
        "ros_to_ngsild:",
        f"  {name}:",
        f"    topic: {topic}",
        f"    type: {type_name}",
        *_qos(qos),
        f"    entity: Device:{device}",
        "    every_ms: 1000",
        "    on_change: true",
        "    attributes:",
    ]
    attributes = list(_attributes(FieldType(type_name), "", store, 0))
    used: set[str] = set()
    for path, remark in attributes[:MAX_ATTRIBUTES]:
        lines.append(f"      {_attribute_name(path, used)}: {path}  # {remark}")
    if len(attributes) > MAX_ATTRIBUTES:
        lines.append(f"      # and {len(attributes) - MAX_ATTRIBUTES} more")
    if not attributes:
        lines.append("      received: {constant: true}")
    return "\n".join(lines) + "\n"


def _qos(qos: Qos | None) -> Iterator[str]:
    """Yield the line for `qos`, if it is not the default; the graph does not report the depth."""
    if qos is None:
        return
    alike = [
        name
        for name, profile in PROFILES.items()
        if (profile.reliability, profile.durability) == (qos.reliability, qos.durability)
    ]
    if "default" in alike:
        return
    if alike:
        yield f"    qos: {alike[0]}"
    else:
        yield f"    qos: {{reliability: {qos.reliability.value}, durability: {qos.durability.value}}}"


def _attributes(kind: FieldType, path: str, store: TypeStore, depth: int) -> Iterator[tuple[str, str]]:
    if kind.many is not Many.ONE:
        if kind.is_octets or (kind.is_message and kind.many is Many.SEQUENCE):
            return
        yield path, str(kind)
        return
    if not kind.is_message:
        yield path, str(kind)
        return
    fields = store.definition(kind.base).fields
    small = len(fields) <= MAX_INLINE_FIELDS and not any(
        field.type.is_message or field.type.is_octets for field in fields
    )
    if path and (small or depth >= MAX_DEPTH):
        yield path, kind.base
        return
    for field in fields:
        if field.type == FieldType(HEADER):
            continue
        yield from _attributes(field.type, f"{path}.{field.name}" if path else field.name, store, depth + 1)


def _attribute_name(path: str, used: set[str]) -> str:
    """Return an attribute name for `path`: its last words, as many as make it unique.

    A field with a reserved name (id, type, scope) gets the prefix `ros`.
    """
    words = path.split(".")
    for many in range(1, len(words) + 1):
        parts = "_".join(words[-many:]).split("_")
        name = parts[0] + "".join(part.capitalize() for part in parts[1:])
        if name not in used and name not in {"id", "type", "scope"}:
            used.add(name)
            return name
    spare = f"ros{words[-1][:1].upper()}{words[-1][1:]}"
    used.add(spare)
    return spare
