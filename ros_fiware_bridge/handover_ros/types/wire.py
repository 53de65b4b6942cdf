"""The wire format of messages: CDR as all ROS 2 middlewares use it (XCDR1, little endian).

rosbags generates the functions that read and write. It packs `byte` as signed and has its own type `char`; on
the wire of ROS 2 both are unsigned octets.
"""

import struct
from collections.abc import Callable
from typing import Any

from handover_ros.errors import BadMessage
from handover_ros.types.definition import Definition, FieldType, Many
from handover_ros.types.excerpt import BIG, LITTLE, Excerpts, FieldNames, Read, text_of_units, wanted

_HEADER_BYTES = 4
_MAX_CACHED_READERS = 1000  # more than the rules of a bridge
_WIDE, _UNITS = "handover/msg/WideText", FieldType("uint32", Many.SEQUENCE)
"""A wstring on the wire: the number of its units of UTF-16 and each in four bytes; no zero ends it. The codec
has it as a structure with these units, since it has no sequences of sequences; a structure adds no bytes."""
_MEMBER = "structure_needs_at_least_one_member"


def attribute(field_name: str) -> str:
    """Return the attribute in which the codec stores a field (`from` is a keyword of Python)."""
    from rosbags.typesys.base import normalize_fieldname  # noqa: PLC0415 - heavy

    return normalize_fieldname(field_name)


class Wire:
    """Encodes and decodes messages; the functions for a type are generated on first use."""

    def __init__(self, definition_of: Callable[[str], Definition]) -> None:
        self._definition_of = definition_of
        self._store: Any = None
        self._met: set[str] = set()
        self._excerpts = (Excerpts(definition_of, BIG), Excerpts(definition_of, LITTLE))
        self._readers: dict[tuple[int, str, frozenset[FieldNames]], Read] = {}

    def encode(self, type_name: str, message: Any) -> bytes:
        """Return the result of `Fitting.message` as CDR."""
        self._meet(type_name)
        return bytes(self._store.serialize_cdr(message, type_name, little_endian=True))

    def decode(self, type_name: str, data: bytes) -> dict[str, Any]:
        """Return the message in `data`.

        Raises:
            BadMessage: it is not a message of this type.
        """
        self._meet(type_name)
        _require_cdr(type_name, data)
        described = self._store.get_msgdef(type_name)
        read = described.deserialize_cdr_le if data[1] else described.deserialize_cdr_be
        try:
            # Bytes behind the message are ignored: the serializer of Fast DDS returns its whole buffer.
            message: dict[str, Any] = read(memoryview(data)[_HEADER_BYTES:], 0, described.cls, self._store)[0]
        except (self._fault, IndexError, struct.error, ValueError, OverflowError) as error:
            raise BadMessage(f"the data is not a message of {type_name}: {error}") from error
        return message

    def excerpt(self, type_name: str, data: bytes, fields: frozenset[FieldNames]) -> dict[str, Any]:
        """Return the `fields` of the message in `data`.

        Raises:
            BadMessage: it is not a message of this type.
        """
        _require_cdr(type_name, data)
        key = (data[1], type_name, fields)
        if (read := self._readers.get(key)) is None:
            read = self._excerpts[data[1]].reader(type_name, wanted(fields))
            if len(self._readers) < _MAX_CACHED_READERS:
                self._readers[key] = read
        try:
            message: dict[str, Any] = read(memoryview(data)[_HEADER_BYTES:], 0)[0]
        except (struct.error, ValueError) as error:
            raise BadMessage(f"the data is not a message of {type_name}: {error}") from error
        return message

    def _meet(self, type_name: str) -> None:
        if type_name in self._met:
            return
        if self._store is None:
            from rosbags.serde import SerdeError  # noqa: PLC0415 - heavy
            from rosbags.typesys.store import Typestore  # noqa: PLC0415

            self._store, self._fault = Typestore(), SerdeError
            self._store.fielddefs[_WIDE] = ([], [("units", _described(_UNITS))])
            self._store.types[_WIDE] = text_of_units
        definition = self._definition_of(type_name)
        for field in definition.fields:
            if field.type.is_message:
                self._meet(field.type.base)
        described = [(field.name, _described(field.type)) for field in definition.fields]
        self._store.fielddefs[type_name] = ([], described or [(_MEMBER, _described(FieldType("uint8")))])
        self._store.types[type_name] = _maker(definition)
        self._met.add(type_name)


def _require_cdr(type_name: str, data: bytes) -> None:
    if data[:2] not in (b"\x00\x00", b"\x00\x01") or len(data) < _HEADER_BYTES:
        raise BadMessage(
            f"the data is not a message of {type_name}: it is not CDR (XCDR1) but begins with "
            f"{data[:_HEADER_BYTES].hex() or 'nothing'}"
        )


def _maker(definition: Definition) -> Callable[..., dict[str, Any]]:
    names = [field.name for field in definition.fields]
    octets = [field.name for field in definition.fields if field.type.is_octets]
    if not names:
        return lambda _member: {}
    if not octets:
        return lambda *values: dict(zip(names, values, strict=True))

    def made(*values: Any) -> dict[str, Any]:
        message = dict(zip(names, values, strict=True))
        for name in octets:
            message[name] = message[name].tobytes()
        return message

    return made


def _described(kind: FieldType) -> Any:
    from rosbags.interfaces import Nodetype  # noqa: PLC0415 - heavy

    if kind.is_message or kind.base == "wstring":
        inner: Any = (Nodetype.NAME, kind.base if kind.is_message else _WIDE)
    else:
        inner = (Nodetype.BASE, ("uint8" if kind.base in ("byte", "char") else kind.base, kind.text_bound))
    if kind.many is Many.ONE:
        return inner
    return (Nodetype.ARRAY if kind.many is Many.FIXED else Nodetype.SEQUENCE, (inner, kind.size))
