"""Scaffolding: a first mapping for a topic, with every field a context broker can use, to be cut down."""

from collections.abc import Iterator

from ros_fiware_bridge.graph.qos import PROFILES, Qos
from ros_fiware_bridge.rules.definitions import HEADER
from ros_fiware_bridge.types.definition import FieldType, Many
from ros_fiware_bridge.types.type_store import TypeStore

DEEPEST = 4
MOST_ATTRIBUTES = 40
SMALL = 4
"""Messages of at most so many fields, all of them plain, become one attribute."""


def mapping_for(topic: str, type_name: str, qos: Qos | None, store: TypeStore) -> str:
    """Return the text of a mapping for `topic`. Raises `GraphError` when the type is not known."""
    store.sound(type_name)
    name = topic.strip("/").replace("/", "-").lower()
    device = topic.strip("/").split("/")[0] if "/" in topic.strip("/") else "robot-1"
    lines = [
        f"# What is said on {topic} becomes attributes of a Device. Take away what nobody needs, and",
        "# say how often it is worth telling; `handover bridge check FILE` says what the mapping would do.",
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
    for path, remark in attributes[:MOST_ATTRIBUTES]:
        lines.append(f"      {_named(path, used)}: {path}  # {remark}")
    if len(attributes) > MOST_ATTRIBUTES:
        lines.append(f"      # and {len(attributes) - MOST_ATTRIBUTES} more")
    if not attributes:
        lines.append("      heard: {constant: true}")
    return "\n".join(lines) + "\n"


def _qos(qos: Qos | None) -> Iterator[str]:
    """Yield the line for `qos`; how many messages are kept is not told on the graph, so it does not count."""
    if qos is None:
        return
    alike = [
        name
        for name, one in PROFILES.items()
        if (one.reliability, one.durability) == (qos.reliability, qos.durability)
    ]
    if "default" in alike:
        return
    if alike:
        yield f"    qos: {alike[0]}"
    else:
        yield f"    qos: {{reliability: {qos.reliability.value}, durability: {qos.durability.value}}}"


def _attributes(found: FieldType, path: str, store: TypeStore, depth: int) -> Iterator[tuple[str, str]]:
    if found.many is not Many.ONE:
        if found.is_octets or (found.is_message and found.many is Many.SEQUENCE):
            return
        yield path, str(found)
        return
    if not found.is_message:
        yield path, str(found)
        return
    fields = store.definition(found.base).fields
    small = len(fields) <= SMALL and not any(one.type.is_message or one.type.is_octets for one in fields)
    if path and (small or depth >= DEEPEST):
        yield path, found.base
        return
    for one in fields:
        if one.type == FieldType(HEADER):
            continue
        yield from _attributes(one.type, f"{path}.{one.name}" if path else one.name, store, depth + 1)


def _named(path: str, used: set[str]) -> str:
    """Return a name for the attribute made of `path`: its last words, as many as tell it from the others.

    A field called like what every entity has (id, type) gets `ros` in front.
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
