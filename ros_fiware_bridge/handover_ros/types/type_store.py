"""The type store: definitions, defaults and hashes of ROS types, and their encoding.

It contains the messages of ROS 2 Jazzy, some services and actions that many robots serve, and the types in
`type_paths`; a type in `type_paths` replaces a built-in type of the same name.
"""

import difflib
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from handover_ros.errors import BadDefinition, UnknownType, UnsupportedType
from handover_ros.types import definition_files, wrappers
from handover_ros.types.definition import Definition, Field, FieldType, Many
from handover_ros.types.excerpt import FieldNames
from handover_ros.types.fitting import Fitting
from handover_ros.types.type_hash import description, rihs01
from handover_ros.types.wire import Wire, attribute

SHIPPED = (Path(__file__).parent / "definitions", Path(__file__).parent.parent / "messages")
"""Excerpts of packages of others, and our own packages."""

# The definitions of the common interfaces in the library have no defaults.
_DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "geometry_msgs/msg/Quaternion": {"w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}
_SERVICE_PARTS = ("_Request", "_Response")
_ACTION_PARTS = ("_Goal", "_Result", "_Feedback")


class TypeStore:
    """Definitions by name and what follows from them; created once per bridge and immutable."""

    def __init__(self, type_paths: Iterable[Path] = ()) -> None:
        """Index the files without reading them.

        Raises:
            BadDefinition: a path of `type_paths` does not exist, or two files define one type differently.
        """
        self._files: dict[str, Path] = {
            name: file for folder in SHIPPED for name, file in definition_files.find(folder)
        }
        self._definitions: dict[str, Definition] = {}
        self._hashes: dict[str, str] = {}
        self._sound: set[str] = set()
        own: dict[str, Path] = {}
        for path in type_paths:
            for type_name, file in definition_files.find(Path(path)):
                first = own.setdefault(type_name, file)
                if first != file and _stripped(first, type_name) != _stripped(file, type_name):
                    raise BadDefinition(
                        f"{type_name} is defined by {first} and, differently, by {file}; "
                        "name one of them in type_paths"
                    )
        self._files.update(own)
        self._own = frozenset(own)
        self._fitting = Fitting(self.definition, attribute)
        self._wire = Wire(self.definition)

    @cached_property
    def _builtin(self) -> dict[str, Definition]:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - takes most of a second

        return {
            name: _from_library(name, constants, fields)
            for name, (constants, fields) in get_typestore(Stores.ROS2_JAZZY).fielddefs.items()
        }

    def type_names(self) -> list[str]:
        """Return every message, service and action type, by name."""
        return sorted({*self._files, *self._builtin})

    def resolve(self, name: str, kind: str = "msg") -> str:
        """Return the full name of a type of `kind` (`msg`, `srv`, `action`), also for `std_msgs/String`.

        Raises:
            UnknownType: there is no such type; the error contains the nearest name.
        """
        parts = name.strip().split("/")
        full = f"{parts[0]}/{kind}/{parts[1]}" if len(parts) == 2 else "/".join(parts)
        if len(parts) not in (2, 3) or (len(parts) == 3 and parts[1] not in definition_files.KINDS):
            raise UnknownType(
                f'"{name}" is not a ROS type; write PACKAGE/{kind}/NAME, as in std_msgs/msg/String'
            )
        if full.split("/")[1] != kind and not (kind == "msg" and "_" in full.rsplit("/", 1)[-1]):
            what = {"msg": "a message", "srv": "a service", "action": "an action"}
            raise UnknownType(f"{full} is {what[full.split('/')[1]]} type, but {what[kind]} type is expected")
        if not self._has(full):
            near = difflib.get_close_matches(full, self.type_names(), n=1, cutoff=0.8)
            hint = f"did you mean {near[0]}? Otherwise name" if near else "name"
            learn = " (handover bridge definitions TOPIC writes it)" if kind == "msg" else ""
            raise UnknownType(
                f"there is no type {full}; {hint} its .{kind} file or folder in type_paths{learn}"
            )
        return full

    def _has(self, full: str) -> bool:
        if full in self._files or full in self._builtin or full in self._definitions:
            return True
        return "_" in full.rsplit("/", 1)[-1] and self._derive(full)

    def definition(self, type_name: str) -> Definition:
        """Return the definition of a message type, also of a request, a goal or a feedback message.

        Raises:
            UnknownType, UnsupportedType, BadDefinition.
        """
        cached = self._definitions.get(type_name)
        if cached is not None:
            return cached
        if type_name in self._files and "/msg/" in type_name:
            (cached,) = definition_files.read(type_name, self._files[type_name])
        elif type_name in self._builtin:
            cached = self._builtin[type_name]
        elif self._derive(type_name):
            return self._definitions[type_name]
        else:
            self.resolve(type_name)
            raise UnknownType(f"{type_name} is not a message type; use its request, goal or result")
        self._definitions[type_name] = cached
        return cached

    def _derive(self, type_name: str) -> bool:
        """Derive the messages of the service or action of `type_name`; False if there is none."""
        package, _, rest = type_name.partition("/")
        kind, _, name = rest.partition("/")
        base = f"{package}/{kind}/{name.split('_')[0]}"
        if kind not in ("srv", "action") or base not in self._files:
            return False
        if f"{base}{(_SERVICE_PARTS if kind == 'srv' else _ACTION_PARTS)[0]}" not in self._definitions:
            made = definition_files.read(base, self._files[base])
            services = [base] if kind == "srv" else [f"{base}_SendGoal", f"{base}_GetResult"]
            if kind == "action":
                made += [*wrappers.of_action(base), *wrappers.hashed_with_action(base)]
            for service in services:
                made += wrappers.hashed_with_service(service)
            self._definitions.update({added.type_name: added for added in made})
        return type_name in self._definitions

    def sound(self, type_name: str) -> Definition:
        """Return the definition, after checking that all its types are known and that it is not recursive.

        Raises:
            UnknownType, UnsupportedType, BadDefinition: the error names the faulty type.
        """
        self._walk(type_name, ())
        return self.definition(type_name)

    def _walk(self, type_name: str, above: tuple[str, ...]) -> None:
        if type_name in above:
            raise UnsupportedType(
                f"{type_name} contains itself ({' > '.join((*above, type_name))}); ROS has no recursive types"
            )
        if type_name in self._sound:
            return
        for field in self.definition(type_name).fields:
            if field.type.is_message:
                try:
                    self._walk(field.type.base, (*above, type_name))
                except UnknownType as error:
                    raise UnknownType(f"{type_name}.{field.name}: {error}") from None
        self._sound.add(type_name)

    def hash(self, type_name: str) -> str:
        """Return the RIHS01 hash of a message, service or action type, `RIHS01_…`."""
        type_hash = self._hashes.get(type_name)
        if type_hash is None:
            if type_name in self._files and "/msg/" not in type_name:
                self._derive(type_name)
            type_hash = self._hashes[type_name] = rihs01(type_name, self.definition)
        return type_hash

    def description(self, type_name: str) -> dict[str, Any]:
        """Return what the hash of a type is of: its fields, and those of all types that it contains."""
        self.hash(type_name)
        return description(type_name, self.definition)

    def encode(self, type_name: str, message: Mapping[str, Any]) -> bytes:
        """Return `message` as CDR (XCDR1, little endian, with its 4 bytes of header).

        Raises:
            BadMessage: the error names the field path, the rule and the value.
        """
        return self._wire.encode(type_name, self._fitting.message(type_name, message))

    def decode(self, type_name: str, data: bytes) -> dict[str, Any]:
        """Return the message in `data` (CDR with header).

        Raises:
            BadMessage: it is not a message of this type.
        """
        return self._wire.decode(type_name, data)

    def excerpt(self, type_name: str, data: bytes, fields: frozenset[FieldNames]) -> dict[str, Any]:
        """Return the `fields`, such as `("header", "stamp")`, of the message in `data`; `()` selects all.

        Other fields are skipped, which takes a fraction of the time of `decode`.

        Raises:
            BadMessage: it is not a message of this type.
        """
        return self._wire.excerpt(type_name, data, fields)

    def check(self, type_name: str, message: Mapping[str, Any]) -> None:
        """Check that `message` can be sent.

        Raises:
            BadMessage: the error names the field path, the rule and the value.
        """
        self._fitting.message(type_name, message)

    def default(self, type_name: str) -> dict[str, Any]:
        """Return a message in which every field has its default."""
        return self.decode(type_name, self.encode(type_name, {}))


def _stripped(file: Path, type_name: str) -> list[Definition]:
    return definition_files.read(type_name, file)


def _from_library(name: str, constants: Any, fields: Any) -> Definition:
    defaults = _DEFAULTS.get(name, {})
    made = [
        Field(field_name, _kind(described), defaults.get(field_name))
        for field_name, described in fields
        if field_name != "structure_needs_at_least_one_member"
    ]
    return Definition(name, tuple(made), {field_name: value for field_name, _, value in constants})


def _kind(described: Any) -> FieldType:
    node, rest = described
    if node == 1:
        base, bound = rest
        return FieldType(base, text_bound=bound)
    if node == 2:
        return FieldType(rest)
    inner, size = rest
    item = _kind(inner)
    return FieldType(item.base, Many.FIXED if node == 3 else Many.SEQUENCE, size, item.text_bound)
