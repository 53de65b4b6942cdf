"""Excerpts: reads selected fields of a CDR message and skips all others.

A rule that reads one joint of a hundred costs as little as one joint: numbers in between are skipped, and
text and sequences are skipped by their lengths. The walk always reaches the end, so that a truncated message
is refused for any selection; only the encoding of skipped text is not checked.

XCDR1: each number is aligned to a multiple of its own size, counted from the end of the header. A structure
has no alignment of its own, so its size depends on its position. (DDSI-RTPS 2.5, 10; CDR of CORBA 3.0.3,
15.3.)
"""

import struct
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np

from handover_ros.types.definition import TEXTS, Definition, FieldType, Many

FieldNames: TypeAlias = tuple[str, ...]
"""The path to a field, from the outermost name inwards; empty for the whole message."""
Wanted: TypeAlias = Mapping[str, "Wanted"]
"""The selected fields by name; a field without entries below it is selected as a whole."""
Skip: TypeAlias = Callable[[memoryview, int], int]
"""Returns the position behind the value at a position of a message."""
Read: TypeAlias = Callable[[memoryview, int], tuple[Any, int]]
"""Returns the value at a position, and the position behind it."""

LITTLE, BIG = "<", ">"
_CODES = {
    "bool": "?",
    "int8": "b",
    "uint8": "B",
    "byte": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
MIN_TEXT_BYTES = {"string": 5, "wstring": 4}
"""The number of bytes or units; a string ends with a zero."""
_MAX_CACHED_BYTES = 65_536
_EMPTY_MEMBER = FieldType("uint8")
"""The member of a structure without members."""


_UNITS = FieldType("uint32", Many.SEQUENCE)
"""How a wstring is written: its units of UTF-16, each in four bytes."""


def text_of_units(units: Any) -> str:
    """Return the text of units of UTF-16, one in each number.

    Raises `ValueError` for more than 16 bits, as where a peer writes two units in four bytes, and for half a
    surrogate pair.
    """
    numbers = np.asarray(units, dtype=np.uint32)
    if numbers.size and int(numbers.max()) > 0xFFFF:
        raise ValueError("a wstring has units of more than 16 bits; its writer has another form of wstring")
    return numbers.astype("<u2").tobytes().decode("utf-16-le")


def wanted(fields: Collection[FieldNames]) -> Wanted:
    """Return the selection as a tree; a field inside one that is selected as a whole adds nothing."""
    tree: dict[str, Any] = {}
    for names in sorted(fields, key=len):
        here = tree
        for name in names:
            if here.get(name) == {}:
                break  # it is selected as a whole
            here = here.setdefault(name, {})
    return {} if () in fields else tree


class Excerpts:
    """Creates the functions that read excerpts, for one byte order (`LITTLE` or `BIG`)."""

    def __init__(self, definition_of: Callable[[str], Definition], order: str) -> None:
        self._definition_of = definition_of
        self._order = order
        self._length = struct.Struct(f"{order}I").unpack_from

    def reader(self, type_name: str, asked: Wanted) -> Read:
        """Return the function that reads messages of `type_name`; it raises ValueError or struct.error."""
        read = self._message(type_name, asked)

        def whole(data: memoryview, at: int) -> tuple[Any, int]:
            message, at = read(data, at)
            if at > len(data):
                raise ValueError(f"it ends after {len(data)} bytes, and {at} are expected")
            return message, at

        return whole

    # Reading

    def _read(self, kind: FieldType, asked: Wanted) -> Read:
        if kind.many is not Many.ONE:
            return self._octets(kind) if kind.is_octets else self._array(kind)
        if kind.is_message:
            return self._message(kind.base, asked)
        if kind.base == "wstring":
            return self._wide_text()
        return self._text() if kind.base == "string" else self._number(kind.base)

    def _message(self, type_name: str, asked: Wanted) -> Read:
        steps: list[tuple[str | None, Callable[[memoryview, int], Any]]] = []
        jumped: list[FieldType] = []
        fields = self._definition_of(type_name).fields
        for field in fields:
            if asked and field.name not in asked:
                jumped.append(field.type)
                continue
            steps += [(None, skip) for skip in self._skips(jumped)]
            steps.append((field.name, self._read(field.type, asked.get(field.name, {}))))
            jumped = []
        steps += [(None, skip) for skip in self._skips(jumped if fields else [_EMPTY_MEMBER])]

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            message: dict[str, Any] = {}
            for name, step in steps:
                if name is None:
                    at = step(data, at)
                else:
                    message[name], at = step(data, at)
            return message, at

        return read

    def _number(self, base: str) -> Read:
        packed = struct.Struct(self._order + _CODES[base])
        size, unpack = packed.size, packed.unpack_from

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            at = (at + size - 1) & -size
            return unpack(data, at)[0], at + size

        return read

    def _text(self) -> Read:
        past = self._past_text()

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            at, end = (at + 3) & -4, past(data, at)
            return str(data[at + 4 : end - 1], "utf-8"), end

        return read

    def _wide_text(self) -> Read:
        read_units = self._numbers(_UNITS)

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            units, at = read_units(data, at)
            return text_of_units(units), at

        return read

    def _octets(self, kind: FieldType) -> Read:
        start = self._start(kind, 1)

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            count, at = start(data, at)
            return bytes(data[at : at + count]), at + count

        return read

    def _array(self, kind: FieldType) -> Read:
        if kind.is_number_array:
            return self._numbers(kind)
        read_one = self._read(kind.item, {})
        start = self._start(kind, 1 if kind.is_message else MIN_TEXT_BYTES[kind.base])

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            count, at = start(data, at)
            items = []
            for _ in range(count):
                item, at = read_one(data, at)
                items.append(item)
            return items, at

        return read if kind.is_message else _texts_unless_as_before(read)

    def _numbers(self, kind: FieldType) -> Read:
        wire = np.dtype(self._order + _CODES[kind.base])
        swapped = not wire.isnative
        size, start = wire.itemsize, self._start(kind, wire.itemsize)

        def read(data: memoryview, at: int) -> tuple[Any, int]:
            count, at = start(data, at)
            if count:
                at = (at + size - 1) & -size
            array: Any = np.frombuffer(data, wire, count, at) if count else np.empty(0, wire)
            if swapped:
                array = array.astype(wire.newbyteorder("="))
            array.flags.writeable = False
            return array, at + size * count

        return read

    # Skipping

    def _skips(self, kinds: Iterable[FieldType]) -> list[Skip]:
        """Return the functions that skip consecutive fields; numbers of one size are skipped together."""
        skips: list[Skip] = []
        size, count = 0, 0
        for kind in kinds:
            even = self._even(kind)
            if even is not None and even[0] == size:
                count += even[1]
                continue
            if count:
                skips.append(_past_numbers(size, count))
            size, count = even or (0, 0)
            if even is None:
                skips.append(self._past(kind))
        if count:
            skips.append(_past_numbers(size, count))
        return skips

    def _even(self, kind: FieldType) -> tuple[int, int] | None:
        """Return the size and the count of the numbers in `kind`, if both are fixed; else None."""
        if kind.many is Many.SEQUENCE or kind.base in TEXTS:
            return None
        many = kind.size if kind.many is Many.FIXED else 1
        if not kind.is_message:
            return struct.calcsize(self._order + _CODES[kind.base]), many
        fields = self._definition_of(kind.base).fields
        evens = [self._even(field.type) for field in fields] or [(1, 1)]
        sizes = {even[0] if even else 0 for even in evens}
        if len(sizes) != 1 or 0 in sizes:
            return None
        return sizes.pop(), many * sum(even[1] for even in evens if even)

    def _past(self, kind: FieldType) -> Skip:
        if kind.many is not Many.ONE:
            return self._past_array(kind)
        if kind.base == "string":
            return self._past_text()
        if kind.base == "wstring":
            return self._past_array(_UNITS)
        skips = self._skips(field.type for field in self._definition_of(kind.base).fields)

        def skip(data: memoryview, at: int) -> int:
            for piece in skips:
                at = piece(data, at)
            return at

        return skip

    def _past_array(self, kind: FieldType) -> Skip:
        even = self._even(kind.item)
        if even is not None:
            size, numbers = even
            start = self._start(kind, size * numbers)

            def jump(data: memoryview, at: int) -> int:
                count, at = start(data, at)
                return ((at + size - 1) & -size) + size * numbers * count if count else at

            return jump
        past = self._past(kind.item)
        start = self._start(kind, 1 if kind.is_message else MIN_TEXT_BYTES[kind.base])

        def skip(data: memoryview, at: int) -> int:
            count, at = start(data, at)
            for _ in range(count):
                at = past(data, at)
            return at

        if kind.is_message:
            return skip
        walk = _unless_as_before(lambda data, at: (None, skip(data, at)))
        return lambda data, at: walk(data, at)[1]

    def _past_text(self) -> Skip:
        length = self._length

        def skip(data: memoryview, at: int) -> int:
            at = (at + 3) & -4
            size = length(data, at)[0]
            end = at + 4 + size
            if size < 1 or end > len(data):
                raise ValueError(f"the length of the text at {at} is {size}, which is impossible")
            if data[end - 1]:
                raise ValueError(f"the text at {at} has no terminating zero")
            return int(end)

        return skip

    def _start(self, kind: FieldType, shortest: int) -> Read:
        """Return the function that reads the number of elements, each of at least `shortest` bytes."""
        length, fixed = self._length, kind.size

        def count_of_fixed(data: memoryview, at: int) -> tuple[int, int]:
            _require_room(data, at, fixed, shortest)
            return fixed, at

        def count(data: memoryview, at: int) -> tuple[int, int]:
            at = (at + 3) & -4
            length_read = length(data, at)[0]
            _require_room(data, at + 4, length_read, shortest)
            return length_read, at + 4

        return count_of_fixed if kind.many is Many.FIXED else count


def _require_room(data: memoryview, at: int, count: int, shortest: int) -> None:
    if at + count * shortest > len(data):
        raise ValueError(f"{count} elements at {at} do not fit into the message")


def _past_numbers(size: int, count: int) -> Skip:
    return lambda _, at: ((at + size - 1) & -size) + size * count


def _texts_unless_as_before(read: Read) -> Read:
    walk = _unless_as_before(read)

    def read_if_new(data: memoryview, at: int) -> tuple[Any, int]:
        texts, at = walk(data, at)
        return list(texts), at

    return read_if_new


def _unless_as_before(read: Read) -> Read:
    """Return a `read` that caches its last result: the names of joints seldom change."""
    before, before_at, last = b"", -1, None

    def read_if_new(data: memoryview, at: int) -> tuple[Any, int]:
        nonlocal before, before_at, last
        end = at + len(before)
        if at == before_at and bytes(data[at:end]) == before:
            return last, end
        value, end = read(data, at)
        if end - at <= _MAX_CACHED_BYTES:
            before, before_at, last = bytes(data[at:end]), at, value
        return value, end

    return read_if_new
