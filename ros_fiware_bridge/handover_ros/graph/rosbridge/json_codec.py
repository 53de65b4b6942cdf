"""Converts messages between the JSON of rosbridge and the form of the port.

JSON has octets as base64, and null for NaN. ROS 1 has `secs` and `nsecs` in times, a `seq` number in headers,
and types without their kind.
"""

import base64
import binascii
import math
from collections.abc import Mapping
from typing import Any

from handover_ros.errors import BadMessage
from handover_ros.graph.port import Message
from handover_ros.types.definition import FLOATS, FieldType, Many
from handover_ros.types.type_store import TypeStore

_TIMES = frozenset({"builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"})
_HEADER = "std_msgs/msg/Header"


class JsonCodec:
    """Converts the messages of one connection; `ros1` is whether the graph is one of ROS 1."""

    def __init__(self, store: TypeStore, *, ros1: bool = False) -> None:
        self.store = store
        self.ros1 = ros1

    def type_name(self, type_name: str) -> str:
        """Return the name of a type on the server, `std_msgs/String` for ROS 1."""
        package, _, name = type_name.split("/")
        return f"{package}/{name}" if self.ros1 else type_name

    def to_json(self, type_name: str, message: Message) -> tuple[dict[str, Any], int]:
        """Return the complete `message` as JSON, and its CDR size in bytes. Raises `BadMessage`."""
        data = self.store.encode(type_name, message)
        made: dict[str, Any] = self._out(FieldType(type_name), self.store.decode(type_name, data), type_name)
        return made, len(data)

    def from_json(self, type_name: str, values: Any) -> bytes:
        """Return a received message as CDR. Raises `BadMessage`."""
        return self.store.encode(type_name, self._in(FieldType(type_name), values))

    def message(self, type_name: str, values: Any) -> Message:
        """Return a received message as a dict. Raises `BadMessage`."""
        return self.store.decode(type_name, self.from_json(type_name, values))

    def _out(self, kind: FieldType, value: Any, where: str) -> Any:
        if kind.is_octets:
            return base64.b64encode(value).decode()
        if kind.many is not Many.ONE:
            return [self._out(kind.item, element, where) for element in value]
        if kind.is_message:
            names = {"sec": "secs", "nanosec": "nsecs"} if self.ros1 and kind.base in _TIMES else {}
            return {
                names.get(field.name, field.name): self._out(
                    field.type, value[field.name], f"{where}.{field.name}"
                )
                for field in self.store.definition(kind.base).fields
            }
        if kind.base in FLOATS:
            if not math.isfinite(value):
                raise BadMessage(
                    f"{where}: {value} cannot be sent over rosbridge, because JSON has no such number"
                )
            return float(value)
        return value.item() if hasattr(value, "item") else value

    def _in(self, kind: FieldType, value: Any) -> Any:
        if kind.is_octets and isinstance(value, str):
            try:
                return base64.b64decode(value, validate=True)
            except (binascii.Error, ValueError) as error:
                raise BadMessage(f"octets are not valid base64: {error}") from None
        if kind.many is not Many.ONE:
            return [self._in(kind.item, element) for element in value] if isinstance(value, list) else value
        if kind.base in FLOATS and value is None:
            return math.nan
        if not kind.is_message or not isinstance(value, Mapping):
            return value
        members = dict(value)
        if kind.base in _TIMES:
            for theirs, ours in (("secs", "sec"), ("nsecs", "nanosec")):
                if theirs in members:
                    members[ours] = members.pop(theirs)
        elif kind.base == _HEADER:
            members.pop("seq", None)
        kinds = {field.name: field.type for field in self.store.definition(kind.base).fields}
        return {
            name: self._in(kinds[name], member) if name in kinds else member
            for name, member in members.items()
        }
