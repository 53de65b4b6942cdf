"""Creates the DDS types by which Cyclone validates samples of ROS messages.

Cyclone validates each sample against this description in C, and drops invalid ones; the type store reads and
writes the fields. The types are final structs without keys, like those of ROS 2.
"""

from collections.abc import Callable
from typing import Any

from handover_ros.graph.cyclone.dds_names import of_type
from handover_ros.types.definition import Definition, Field, FieldType, Many

_HEADER = (Field("handover_writer_guid", FieldType("uint64")), Field("handover_sequence", FieldType("int64")))
"""The header of a request or reply in the Cyclone mapping: the client's id and the request number."""


class IdlTypes:
    """Creates and caches the DDS types of one graph."""

    def __init__(self, definition_of: Callable[[str], Definition]) -> None:
        self._definition_of = definition_of
        self._made: dict[tuple[str, bool], Any] = {}

    def of(self, type_name: str, *, with_header: bool = False) -> Any:
        """Return the class for a topic of this type; it is never instantiated."""
        key = (type_name, with_header)
        if key not in self._made:
            fields = self._definition_of(type_name).fields
            # The fields of a request are inlined into the wrapper: nested, both would have the same DDS name.
            made = self._struct(type_name, (*_HEADER, *fields) if with_header else fields)
            self._made[key] = made
        return self._made[key]

    def _struct(self, type_name: str, fields: tuple[Field, ...]) -> Any:
        from cyclonedds.idl import make_idl_struct  # noqa: PLC0415 - heavy

        kinds = {field.name: self._kind(field.type) for field in fields}
        if not kinds:
            kinds = {"structure_needs_at_least_one_member": self._kind(FieldType("uint8"))}
        made = make_idl_struct(
            of_type(type_name).replace("::", "_"), of_type(type_name), kinds, dataclassify=False
        )
        made.__idl_annotations__["extensibility"] = "final"
        return made

    def _kind(self, kind: FieldType) -> Any:
        import cyclonedds.idl.types as described  # noqa: PLC0415 - heavy

        types: Any = described  # its classes are indexed by values that mypy cannot follow

        if kind.is_message:
            key = (kind.base, False)
            if key not in self._made:
                self._made[key] = self._struct(kind.base, self._definition_of(kind.base).fields)
            made = self._made[key]
        elif kind.base == "string":
            made = types.bounded_str[kind.text_bound] if kind.text_bound else str
        elif kind.base == "wstring":
            made = types.sequence[types.uint32]  # the same on the wire
        elif kind.base == "bool":
            made = bool
        else:
            made = getattr(types, {"byte": "uint8", "char": "uint8"}.get(kind.base, kind.base))
        if kind.many is Many.FIXED:
            return types.array[made, kind.size]
        if kind.many is Many.SEQUENCE:
            return types.sequence[made, kind.size] if kind.size else types.sequence[made]
        return made
