"""An excerpt: those fields of a message that somebody asks for, read from CDR past all the others.

A rule that wants one joint of a hundred pays for one: numbers that nobody asks for are jumped over, text and
sequences are walked by their lengths. The walk goes to the end, so that a message cut short is refused
whatever is asked for; only whether text that nobody asks for is text is not looked at.

XCDR1: each number stands at a multiple of its own size, counted from behind the header, and a structure adds
nothing to that; so a structure may be longer at one place than at another. (DDSI-RTPS 2.5, 10; CDR of CORBA
3.0.3, 15.3.)
"""

import struct
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np

from ros_fiware_bridge.types.definition import Definition, FieldType, Many

FieldNames: TypeAlias = tuple[str, ...]
"""The way to a field from the outside in; none for the whole message."""
Wanted: TypeAlias = Mapping[str, "Wanted"]
"""What is asked for, by field; a field with nothing below is asked for as a whole."""
Skip: TypeAlias = Callable[[memoryview, int], int]
"""Returns the place behind what stands at a place of a message."""
Read: TypeAlias = Callable[[memoryview, int], tuple[Any, int]]
"""Returns what stands there, too."""

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
_SHORTEST_TEXT = 5
_LONGEST_REMEMBERED = 65_536
_NOTHING = FieldType("uint8")
"""What stands for a structure without members."""


def wanted(fields: Collection[FieldNames]) -> Wanted:
    """Return what is asked for, field by field; a field of one that is wanted whole is wanted already."""
    tree: dict[str, Any] = {}
    for names in sorted(fields, key=len):
        here = tree
        for name in names:
            if here.get(name) == {}:
                break  # it is wanted whole
            here = here.setdefault(name, {})
    return {} if () in fields else tree


class Excerpts:
    """Makes the functions that read excerpts, of one byte order (`LITTLE` or `BIG`)."""

    def __init__(self, definition_of: Callable[[str], Definition], order: str) -> None:
        self._definition_of = definition_of
        self._order = order
        self._length = struct.Struct(f"{order}I").unpack_from

    def reader(self, type_name: str, asked: Wanted) -> Read:
        """Return what reads messages of `type_name`; it raises ValueError or struct.error."""
        read = self._message(type_name, asked)

        def whole(data: memoryview, at: int) -> tuple[Any, int]:
            message, at = read(data, at)
            if at > len(data):
                raise ValueError(f"it ends after {len(data)} bytes, and {at} are wanted")
            return message, at

        return whole

    # What is read

    def _read(self, kind: FieldType, asked: Wanted) -> Read:
        if kind.many is not Many.ONE:
            return self._octets(kind) if kind.is_octets else self._array(kind)
        if kind.is_message:
            return self._message(kind.base, asked)
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
        steps += [(None, skip) for skip in self._skips(jumped if fields else [_NOTHING])]

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
        start = self._start(kind, 1 if kind.is_message else _SHORTEST_TEXT)

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

    # What is jumped over

    def _skips(self, kinds: Iterable[FieldType]) -> list[Skip]:
        """Return what goes past fields that follow each other, numbers of one size in one go."""
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
        """Return the size of the numbers that `kind` is made of and how many they are, if both are fixed."""
        if kind.many is Many.SEQUENCE or kind.base == "string":
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
        skips = self._skips(field.type for field in self._definition_of(kind.base).fields)

        def skip(data: memoryview, at: int) -> int:
            for one in skips:
                at = one(data, at)
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
        start = self._start(kind, 1 if kind.is_message else _SHORTEST_TEXT)

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
                raise ValueError(f"at {at} stands the length of a text, {size}, which cannot be")
            if data[end - 1]:
                raise ValueError(f"the text at {at} does not end with a zero")
            return int(end)

        return skip

    def _start(self, kind: FieldType, shortest: int) -> Read:
        """Return what reads how many items there are, each of `shortest` bytes or more."""
        length, fixed = self._length, kind.size

        def count_of_fixed(data: memoryview, at: int) -> tuple[int, int]:
            _require_room(data, at, fixed, shortest)
            return fixed, at

        def count(data: memoryview, at: int) -> tuple[int, int]:
            at = (at + 3) & -4
            found = length(data, at)[0]
            _require_room(data, at + 4, found, shortest)
            return found, at + 4

        return count_of_fixed if kind.many is Many.FIXED else count


def _require_room(data: memoryview, at: int, count: int, shortest: int) -> None:
    if at + count * shortest > len(data):
        raise ValueError(f"{count} items stand at {at}, more than the message has bytes for")


def _past_numbers(size: int, count: int) -> Skip:
    return lambda _, at: ((at + size - 1) & -size) + size * count


def _texts_unless_as_before(read: Read) -> Read:
    walk = _unless_as_before(read)

    def read_if_new(data: memoryview, at: int) -> tuple[Any, int]:
        texts, at = walk(data, at)
        return list(texts), at

    return read_if_new


def _unless_as_before(read: Read) -> Read:
    """Return `read`, which walks again only through what has changed: the names of joints seldom do."""
    before, before_at, known = b"", -1, None

    def read_if_new(data: memoryview, at: int) -> tuple[Any, int]:
        nonlocal before, before_at, known
        end = at + len(before)
        if at == before_at and bytes(data[at:end]) == before:
            return known, end
        found, end = read(data, at)
        if end - at <= _LONGEST_REMEMBERED:
            before, before_at, known = bytes(data[at:end]), at, found
        return found, end

    return read_if_new
