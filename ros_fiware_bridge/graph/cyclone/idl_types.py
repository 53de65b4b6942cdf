"""DDS types: what Cyclone must know of a ROS message to check what comes from the network.

Cyclone checks each sample against this description in C, and drops what does not fit it; the fields are read
and written by the type store. Final structs without keys, as ROS 2 has them.
"""

from collections.abc import Callable
from typing import Any

from ros_fiware_bridge.graph.cyclone.dds_names import of_type
from ros_fiware_bridge.types.definition import Definition, Field, FieldType, Many

_HEADER = (Field("handover_writer_guid", FieldType("uint64")), Field("handover_sequence", FieldType("int64")))
"""What the Cyclone mapping puts before a request or reply: who asked, and the number of the request."""


class IdlTypes:
    """Makes and keeps the DDS types of one graph."""

    def __init__(self, definition_of: Callable[[str], Definition]) -> None:
        self._definition_of = definition_of
        self._made: dict[tuple[str, bool], Any] = {}

    def of(self, type_name: str, *, with_header: bool = False) -> Any:
        """Return the class to make a topic with; there are never instances of it."""
        key = (type_name, with_header)
        if key not in self._made:
            fields = self._definition_of(type_name).fields
            # A request's fields stand in the wrapper itself: nested, both would have the same DDS name.
            made = self._struct(type_name, (*_HEADER, *fields) if with_header else fields)
            self._made[key] = made
        return self._made[key]

    def _struct(self, type_name: str, fields: tuple[Field, ...]) -> Any:
        from cyclonedds.idl import make_idl_struct  # noqa: PLC0415 - heavy

        kinds = {one.name: self._kind(one.type) for one in fields}
        if not kinds:
            kinds = {"structure_needs_at_least_one_member": self._kind(FieldType("uint8"))}
        made = make_idl_struct(
            of_type(type_name).replace("::", "_"), of_type(type_name), kinds, dataclassify=False
        )
        made.__idl_annotations__["extensibility"] = "final"
        return made

    def _kind(self, kind: FieldType) -> Any:
        import cyclonedds.idl.types as described  # noqa: PLC0415 - heavy

        types: Any = described  # its classes are indexed by what its checker cannot follow

        if kind.is_message:
            key = (kind.base, False)
            if key not in self._made:
                self._made[key] = self._struct(kind.base, self._definition_of(kind.base).fields)
            one = self._made[key]
        elif kind.base == "string":
            one = types.bounded_str[kind.text_bound] if kind.text_bound else str
        elif kind.base == "bool":
            one = bool
        else:
            one = getattr(types, {"byte": "uint8", "char": "uint8"}.get(kind.base, kind.base))
        if kind.many is Many.FIXED:
            return types.array[one, kind.size]
        if kind.many is Many.SEQUENCE:
            return types.sequence[one, kind.size] if kind.size else types.sequence[one]
        return one
