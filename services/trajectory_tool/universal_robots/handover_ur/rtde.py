"""Real-Time Data Exchange, protocol version 2: packages, recipes and their encoding, without I/O.

A package is a size (2 bytes, with the header), a type (1 byte) and a payload; numbers are big-endian. A
client sets up recipes, lists of variables; after START the controller sends its output at a fixed rate.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide".
"""

import struct
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import pairwise

from handover.errors import HandoverError

PROTOCOL_VERSION = 2
PORT = 30004

HEADER = struct.Struct(">HB")
MAX_PACKAGE_BYTES = 0xFFFF
MAX_RECEIVED_BYTES = 4096
"""No package of these exchanges is nearly as large; waiting for the rest of one would stop all reports."""
MIN_VERSIONS = {3: 10, 5: 4}
"""The least minor version of each major version that is supported: CB3 series and e-Series."""
UNKNOWN_TYPES = frozenset({"NOT_FOUND", "IN_USE"})

Value = float | tuple[float, ...]
Values = dict[str, Value]

_FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


class ProtocolError(HandoverError):
    """The peer sent what the protocol does not allow; the connection cannot be used any longer."""


class RecipeError(HandoverError):
    """The controller rejects a recipe; the message names the variables."""


class PackageType(IntEnum):
    """The type of a package; a reply has the type of its request."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_URCONTROL_VERSION = ord("v")
    TEXT_MESSAGE = ord("M")
    DATA_PACKAGE = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class Severity(IntEnum):
    """The warning level of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


@dataclass(frozen=True, slots=True)
class Package:
    """One package as read from the stream; `kind` may be a type that this module does not know."""

    kind: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class ControllerVersion:
    """The version of the controller's software."""

    major: int
    minor: int
    bugfix: int
    build: int

    @property
    def frequency_hz(self) -> float:
        """Return the control frequency: 125 Hz up to the CB series, 500 Hz from the e-Series."""
        return 125.0 if self.major < 5 else 500.0

    @property
    def is_supported(self) -> bool:
        """Return whether the driver is made for this version."""
        return self.minor >= MIN_VERSIONS.get(self.major, sys.maxsize)

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


@dataclass(frozen=True, slots=True)
class TextMessage:
    """A message of the controller."""

    text: str
    source: str
    severity: Severity


class PackageReader:
    """Splits a byte stream into packages; `feed` takes whatever a socket has returned."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, received: bytes) -> list[Package]:
        """Return the packages that are now complete. Raises `ProtocolError`."""
        buffer = self._buffer
        buffer += received
        packages: list[Package] = []
        begin = 0
        while len(buffer) - begin >= HEADER.size:
            size, kind = HEADER.unpack_from(buffer, begin)
            if size < HEADER.size:
                raise ProtocolError(f"an RTDE package of {size} bytes is smaller than its header")
            if size > MAX_RECEIVED_BYTES:
                raise ProtocolError(
                    f"an RTDE package of {size} bytes is larger than {MAX_RECEIVED_BYTES}; is the address "
                    "that of an RTDE interface?"
                )
            if len(buffer) - begin < size:
                break
            packages.append(Package(kind, bytes(buffer[begin + HEADER.size : begin + size])))
            begin += size
        del buffer[:begin]
        return packages


class Recipe:
    """Variables in the order of a data package, with their types. Raises `RecipeError`."""

    def __init__(self, recipe_id: int, names: Sequence[str], types: Sequence[str]) -> None:
        if len(names) != len(types):
            raise RecipeError(f"the controller answers {len(types)} types for {len(names)} variables")
        missing = [
            f"{name} ({kind})" for name, kind in zip(names, types, strict=True) if kind not in _FORMATS
        ]
        if missing:
            raise RecipeError(
                f"the controller does not offer {', '.join(missing)}; IN_USE: another RTDE client writes "
                "the variable, NOT_FOUND: the software of the controller is too old"
            )
        self.id = recipe_id
        self.names = tuple(names)
        self.types = tuple(types)
        self._struct = struct.Struct(">" + "".join(_FORMATS[kind] for kind in types))

    @property
    def size_bytes(self) -> int:
        """Return the size of the values of a data package."""
        return self._struct.size

    @cached_property
    def _places(self) -> tuple[tuple[str, int, int], ...]:
        lengths = [int(_FORMATS[kind][:-1] or 1) for kind in self.types]
        ends = [0]
        for length in lengths:
            ends.append(ends[-1] + length)
        return tuple((name, *span) for name, span in zip(self.names, pairwise(ends), strict=True))

    def decode(self, payload: bytes) -> Values:
        """Return the values of a data package. Raises `ProtocolError`."""
        if len(payload) != self.size_bytes + 1:
            raise ProtocolError(
                f"a data package has {len(payload)} bytes, and recipe {self.id} needs {self.size_bytes + 1}"
            )
        if payload[0] != self.id:
            raise ProtocolError(f"a data package has the recipe {payload[0]}, and {self.id} is expected")
        flat = self._struct.unpack_from(payload, 1)
        return {
            name: flat[begin] if end - begin == 1 else flat[begin:end] for name, begin, end in self._places
        }

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return the data package with these values, one for each variable."""
        flat: list[float] = []
        for name in self.names:
            value = values[name]
            flat.extend(value) if isinstance(value, tuple) else flat.append(value)
        return package(PackageType.DATA_PACKAGE, bytes((self.id,)) + self._struct.pack(*flat))


def package(kind: PackageType, payload: bytes = b"") -> bytes:
    """Return an encoded package. Raises `ProtocolError` when it is too large."""
    size = HEADER.size + len(payload)
    if size > MAX_PACKAGE_BYTES:
        raise ProtocolError(f"a package of {size} bytes is larger than {MAX_PACKAGE_BYTES}")
    return HEADER.pack(size, kind) + payload


def request_protocol_version(version: int = PROTOCOL_VERSION) -> bytes:
    """Return the request to use a protocol version."""
    return package(PackageType.REQUEST_PROTOCOL_VERSION, struct.pack(">H", version))


def setup_outputs(names: Sequence[str], frequency_hz: float) -> bytes:
    """Return the request for an output recipe at a frequency."""
    return package(PackageType.SETUP_OUTPUTS, struct.pack(">d", frequency_hz) + ",".join(names).encode())


def setup_inputs(names: Sequence[str]) -> bytes:
    """Return the request for an input recipe."""
    return package(PackageType.SETUP_INPUTS, ",".join(names).encode())


def text_message(message: TextMessage) -> bytes:
    """Return a text message; text and source are cut at 255 bytes."""
    text, source = message.text.encode()[:255], message.source.encode()[:255]
    parts = (bytes((len(text),)), text, bytes((len(source),)), source, bytes((message.severity,)))
    return package(PackageType.TEXT_MESSAGE, b"".join(parts))


def parse_accepted(payload: bytes) -> bool:
    """Return the answer to a protocol version, START or PAUSE. Raises `ProtocolError`."""
    if len(payload) != 1:
        raise ProtocolError(f"an answer has {len(payload)} bytes, and 1 is expected")
    return payload[0] == 1


def parse_version(payload: bytes) -> ControllerVersion:
    """Return the version of the controller. Raises `ProtocolError`."""
    if len(payload) != 16:
        raise ProtocolError(f"a version has {len(payload)} bytes, and 16 are expected")
    return ControllerVersion(*struct.unpack(">IIII", payload))


def parse_recipe(payload: bytes, names: Sequence[str]) -> Recipe:
    """Return the recipe that the controller has set up. Raises `ProtocolError` or `RecipeError`."""
    if not payload:
        raise ProtocolError("the answer to a recipe is empty")
    try:
        types = payload[1:].decode("ascii").split(",")
    except UnicodeDecodeError:
        raise ProtocolError("the types of a recipe are not ASCII") from None
    return Recipe(payload[0], names, types)


def parse_names(payload: bytes) -> list[str]:
    """Return the variables of a recipe request, without its frequency. Raises `ProtocolError`."""
    try:
        return payload.decode("ascii").split(",")
    except UnicodeDecodeError:
        raise ProtocolError("the variables of a recipe are not ASCII") from None


def parse_text_message(payload: bytes) -> TextMessage:
    """Return a text message; text that is not UTF-8 is replaced. Raises `ProtocolError`."""
    try:
        text_end = 1 + payload[0]
        source_end = text_end + 1 + payload[text_end]
        text, source = payload[1:text_end], payload[text_end + 1 : source_end]
        severity = payload[source_end]
    except IndexError:
        raise ProtocolError("a text message is truncated") from None
    is_known = severity in set(Severity)
    return TextMessage(
        text.decode(errors="replace"),
        source.decode(errors="replace"),
        Severity(severity) if is_known else Severity.INFO,
    )
