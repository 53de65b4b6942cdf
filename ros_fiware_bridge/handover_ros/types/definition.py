"""The definition of a ROS message: its fields in order, each with its type, bounds and default."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum
from types import MappingProxyType
from typing import Any

INTEGER_RANGES: Mapping[str, tuple[int, int]] = MappingProxyType(
    {
        "int8": (-(2**7), 2**7 - 1),
        "uint8": (0, 2**8 - 1),
        "byte": (0, 2**8 - 1),
        "char": (0, 2**8 - 1),
        "int16": (-(2**15), 2**15 - 1),
        "uint16": (0, 2**16 - 1),
        "int32": (-(2**31), 2**31 - 1),
        "uint32": (0, 2**32 - 1),
        "int64": (-(2**63), 2**63 - 1),
        "uint64": (0, 2**64 - 1),
    }
)
FLOATS = frozenset({"float32", "float64"})
OCTETS = frozenset({"uint8", "byte", "char"})
"""Arrays of these types are bytes in a message."""
TEXTS = frozenset({"string", "wstring"})
PRIMITIVES = frozenset({*INTEGER_RANGES, *FLOATS, *TEXTS, "bool"})


class Many(Enum):
    """Whether a field has one value, a fixed number of values, or any number."""

    ONE = "one"
    FIXED = "fixed"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class FieldType:
    """The type of a field: `base` is a primitive (`float64`, `string`) or a message type.

    `size` is the length of a fixed array or the bound of a sequence (0: none); `text_bound` is the bound of a
    string in bytes, of a wstring in units of UTF-16 (0: none).
    """

    base: str
    many: Many = Many.ONE
    size: int = 0
    text_bound: int = 0

    @property
    def is_message(self) -> bool:
        """Whether the base is a message type."""
        return self.base not in PRIMITIVES

    @property
    def is_octets(self) -> bool:
        """Whether it is an array that is bytes in a message."""
        return self.many is not Many.ONE and self.base in OCTETS

    @property
    def is_number_array(self) -> bool:
        """Whether it is an array that is decoded to a NumPy array."""
        return (
            self.many is not Many.ONE
            and not self.is_message
            and self.base not in TEXTS
            and not self.is_octets
        )

    @property
    def item(self) -> "FieldType":
        """The type of one element of the array."""
        return FieldType(self.base, text_bound=self.text_bound)

    def __str__(self) -> str:
        base = f"{self.base}<={self.text_bound}" if self.text_bound else self.base
        if self.many is Many.ONE:
            return base
        if self.many is Many.FIXED:
            return f"{base}[{self.size}]"
        return f"{base}[<={self.size}]" if self.size else f"{base}[]"


@dataclass(frozen=True, slots=True)
class Field:
    """A field; `default` is None if the definition gives none (then it is zero, empty or false)."""

    name: str
    type: FieldType
    default: Any = None


@dataclass(frozen=True, slots=True)
class Definition:
    """The definition of one message type, `sensor_msgs/msg/JointState`."""

    type_name: str
    fields: tuple[Field, ...]
    constants: Mapping[str, Any] = field(default_factory=dict)

    def field(self, name: str) -> Field | None:
        """Return the field of that name, or None."""
        return next((candidate for candidate in self.fields if candidate.name == name), None)

    def suggest_field(self, name: str) -> str:
        """Return a hint for an unknown field: the one that `name` may mean, or all fields."""
        names = [candidate.name for candidate in self.fields]
        if close := get_close_matches(name, names, n=1):
            return f'did you mean "{close[0]}"?'
        return f"it has {', '.join(names) or 'no fields'}"
