"""Python classes and type support for types with which the installed ROS was not built.

A package of ROS brings C code for each of its types. Of that code rclpy and rmw_fastrtps_cpp use a table of
functions (`rosidl_message_type_support_t`): create and destroy a message, convert it from and to Python,
write it to and read it from a buffer of Fast CDR, describe it. This module makes such tables from definition
files: a "message" of C is an opaque address here, and the CDR is that of `TypeStore`. So any type with a
definition file can be called, without a compiler.

The layout of the tables, and of a buffer of Fast CDR, belongs to one release of ROS: `supports` refuses all
but those that were tested.

Threads: rclpy holds the interpreter while it calls rmw functions that serialize, so a callback never waits
for it with a lock of Fast DDS in hand.
"""

import ctypes
import functools
import importlib
import itertools
import os
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

import structlog

from handover_ros.errors import AdapterUnavailable
from handover_ros.types import wrappers
from handover_ros.types.definition import Field, FieldType, Many
from handover_ros.types.type_store import TypeStore

log = structlog.get_logger(__name__)

MIDDLEWARE = "rmw_fastrtps_cpp"
_IDENTIFIER = b"rosidl_typesupport_fastrtps_c"
_TESTED = {"ros-rosidl-typesupport-fastrtps-c": "3.6.", "ros-rosidl-runtime-c": "4.6.", "ros-fastcdr": "2.2."}
"""The releases of the wheels whose tables these are; those of ROS 2 Jazzy."""
_TESTED_ROS = "jazzy"

_INTROSPECTION = "rosidl_typesupport_introspection_c"
_INTROSPECTION_IDS = {
    "float32": 1, "float64": 2, "bool": 6, "byte": 7, "uint8": 8, "char": 8, "int8": 9, "uint16": 10,
    "int16": 11, "uint32": 12, "int32": 13, "uint64": 14, "int64": 15, "string": 16, "wstring": 17,
}  # fmt: skip
_INTROSPECTION_MESSAGE = 18

_HEADER_BYTES = 4
_UNBOUNDED = b"\x00"
_LEAST_BUFFER_BYTES = 512
_HASH_VERSION = 1

_PLACEHOLDER = Field("structure_needs_at_least_one_member", FieldType("uint8"))
"""The only field of a message without fields, as rosidl has it."""

_ADDRESSES = itertools.count(1)
_messages: dict[int, Any] = {}
"""The Python object of each "message" of C, by the address that C has of it."""


class _MessageCallbacks(ctypes.Structure):
    """`message_type_support_callbacks_t` of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialize", ctypes.c_void_p),
        ("deserialize", ctypes.c_void_p),
        ("serialized_size", ctypes.c_void_p),
        ("max_serialized_size", ctypes.c_void_p),
        ("key_callbacks", ctypes.c_void_p),
    )


class _Member(ctypes.Structure):
    """`rosidl_typesupport_introspection_c__MessageMember`; of its functions none is called for a topic."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("type_id", ctypes.c_uint8),
        ("string_bound", ctypes.c_size_t),
        ("members", ctypes.c_void_p),
        ("is_key", ctypes.c_bool),
        ("is_array", ctypes.c_bool),
        ("array_size", ctypes.c_size_t),
        ("is_bounded", ctypes.c_bool),
        ("offset", ctypes.c_uint32),
        ("default", ctypes.c_void_p),
        ("functions", ctypes.c_void_p * 6),
    )


class _Members(ctypes.Structure):
    """`rosidl_typesupport_introspection_c__MessageMembers`."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("count", ctypes.c_uint32),
        ("size_of", ctypes.c_size_t),
        ("has_key", ctypes.c_bool),
        ("members", ctypes.c_void_p),
        ("functions", ctypes.c_void_p * 2),
    )


class _ServiceCallbacks(ctypes.Structure):
    """`service_type_support_callbacks_t` of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
    )


class _MessageSupport(ctypes.Structure):
    """`rosidl_message_type_support_t`."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _ServiceSupport(ctypes.Structure):
    """`rosidl_service_type_support_t`."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
        ("event", ctypes.c_void_p),
        ("create_event", ctypes.c_void_p),
        ("destroy_event", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _ActionSupport(ctypes.Structure):
    """`rosidl_action_type_support_t`."""

    _fields_ = (
        ("send_goal", ctypes.c_void_p),
        ("get_result", ctypes.c_void_p),
        ("cancel", ctypes.c_void_p),
        ("feedback", ctypes.c_void_p),
        ("status", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Cdr(ctypes.Structure):
    """`eprosima::fastcdr::Cdr`: callbacks, then its buffer. No method returns the length of the buffer."""

    _fields_ = (("callbacks", ctypes.c_uint8 * 0x70), ("buffer", ctypes.c_void_p))


class _Buffer(ctypes.Structure):
    """`eprosima::fastcdr::FastBuffer`."""

    _fields_ = (("methods", ctypes.c_void_p), ("begin", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _Hash(ctypes.Structure):
    """`rosidl_type_hash_t`."""

    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


class _Text(ctypes.Structure):
    """`rosidl_runtime_c__String`."""

    _fields_ = (("data", ctypes.c_char_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


class _Sequence(ctypes.Structure):
    """`…__Sequence` of any structure."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


class _FieldType(ctypes.Structure):
    _fields_ = (
        ("type_id", ctypes.c_uint8),
        ("capacity", ctypes.c_uint64),
        ("string_capacity", ctypes.c_uint64),
        ("nested_type_name", _Text),
    )


class _Field(ctypes.Structure):
    _fields_ = (("name", _Text), ("type", _FieldType), ("default_value", _Text))


class _IndividualDescription(ctypes.Structure):
    _fields_ = (("type_name", _Text), ("fields", _Sequence))


class _Description(ctypes.Structure):
    """`rosidl_runtime_c__type_description__TypeDescription`."""

    _fields_ = (("type_description", _IndividualDescription), ("referenced", _Sequence))


_OnSerialize = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
_OnDeserialize = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
_OnSize = ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)
_OnMaxSize = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.POINTER(ctypes.c_char))
_OnAsk = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
_OnFind = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_OnCreate = ctypes.CFUNCTYPE(ctypes.c_void_p)
_OnDestroy = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
_FromPython = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
_ToPython = ctypes.CFUNCTYPE(ctypes.py_object, ctypes.c_void_p)


def supports(middleware: str) -> bool:
    """Return whether types can be made for the installed ROS, which runs `middleware`."""
    if middleware != MIDDLEWARE:
        return False
    try:
        return all(metadata.version(name).startswith(release) for name, release in _TESTED.items())
    except metadata.PackageNotFoundError:
        return os.environ.get("ROS_DISTRO") == _TESTED_ROS


class DefinedMessage:
    """A message of a type that was made from its definition, with its fields as rclpy reads and sets them.

    A received message is decoded when a field is read, so that what cannot be read raises `BadMessage` there.
    """

    store: TypeStore
    type_name: str

    def __init__(self, content: Mapping[str, Any] | None = None, cdr: bytes | None = None) -> None:
        self.__dict__.update(content=content, cdr=cdr)

    def __getattr__(self, name: str) -> Any:
        """Return a field; a message as an instance of its class."""
        kind = self._type_of(name)
        if self.content is None and self.cdr is not None:
            value = self.store.excerpt(self.type_name, self.cdr, frozenset({(name,)}))[name]
        else:
            value = self._decoded()[name]
        if not kind.is_message:
            return value
        made = _class_of(self.store, kind.base)
        if issubclass(made, DefinedMessage):
            return made(value)
        from rclpy.serialization import deserialize_message  # noqa: PLC0415 - is only there where ROS is

        return deserialize_message(self.store.encode(kind.base, value), made)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set a field; a message to an instance of its class."""
        kind = self._type_of(name)
        if isinstance(value, DefinedMessage):
            value = value._decoded()
        elif kind.is_message:
            from rclpy.serialization import serialize_message  # noqa: PLC0415 - is only there where ROS is

            value = self.store.decode(kind.base, serialize_message(value))
        self.__dict__.update(content={**self._decoded(), name: value}, cdr=None)

    def encoded(self) -> bytes:
        """Return the message as CDR with its header."""
        if self.cdr is None:
            self.__dict__["cdr"] = self.store.encode(self.type_name, self._decoded())
        encoded: bytes = self.cdr
        return encoded

    def _decoded(self) -> Mapping[str, Any]:
        if self.content is None:
            empty = self.cdr is None
            content = (
                self.store.default(self.type_name) if empty else self.store.decode(self.type_name, self.cdr)
            )
            self.__dict__["content"] = content
        decoded: Mapping[str, Any] = self.content
        return decoded

    def _type_of(self, name: str) -> FieldType:
        field = None if name.startswith("_") else self.store.definition(self.type_name).field(name)
        if field is None:
            raise AttributeError(f"{self.type_name} has no field {name}")
        return field.type


class _Made:
    """The classes and tables that were made for one type store; they live as long as the process."""

    def __init__(self, store: TypeStore) -> None:
        self.store = store
        self.kept: list[Any] = []
        """Everything to which C has pointers."""
        self.classes: dict[str, type] = {}
        self.introspected: dict[str, int] = {}

    def keep(self, made: Any) -> Any:
        self.kept.append(made)
        return made

    def address(self, made: Any) -> int:
        """Return the address of a structure or a function, which is kept."""
        self.keep(made)
        if isinstance(made, ctypes.Structure | ctypes.Array):
            return ctypes.addressof(made)
        return ctypes.cast(made, ctypes.c_void_p).value or 0

    def text(self, text: str) -> _Text:
        data = self.keep(text.encode())
        return _Text(data, len(data), len(data) + 1)

    def sequence(self, kind: type[ctypes.Structure], items: list[Any]) -> _Sequence:
        if not items:
            return _Sequence(None, 0, 0)
        return _Sequence(self.address((kind * len(items))(*items)), len(items), len(items))

    def returning(self, address: int) -> int:
        return self.address(_OnAsk(lambda _: address))

    def about(self, type_name: str) -> dict[str, int]:
        """Return the functions that describe a type: its hash, its description, no sources."""
        digest = bytes.fromhex(self.store.hash(type_name).rpartition("_")[2])
        described = self.store.description(type_name)
        description = _Description(
            self.individual(described["type_description"]),
            self.sequence(
                _IndividualDescription,
                [self.individual(referenced) for referenced in described["referenced_type_descriptions"]],
            ),
        )
        return {
            "hash": self.returning(self.address(_Hash(_HASH_VERSION, (ctypes.c_uint8 * 32)(*digest)))),
            "description": self.returning(self.address(description)),
            "sources": self.returning(self.address(_Sequence(None, 0, 0))),
        }

    def individual(self, described: Mapping[str, Any]) -> _IndividualDescription:
        fields = [
            _Field(
                self.text(field["name"]),
                _FieldType(
                    field["type"]["type_id"],
                    field["type"]["capacity"],
                    field["type"]["string_capacity"],
                    self.text(field["type"]["nested_type_name"]),
                ),
                self.text(""),
            )
            for field in described["fields"]
        ]
        return _IndividualDescription(self.text(described["type_name"]), self.sequence(_Field, fields))

    def message(self, type_name: str) -> type:
        """Return the class of a message."""
        if type_name not in self.classes:
            package, kind, name = type_name.split("/")
            functions = {
                "_CREATE_ROS_MESSAGE": self.capsule(_OnCreate(_create)),
                "_DESTROY_ROS_MESSAGE": self.capsule(_OnDestroy(_destroy)),
                "_CONVERT_FROM_PY": self.capsule(_FromPython(_from_python)),
                "_CONVERT_TO_PY": self.capsule(_ToPython(_messages.__getitem__)),
            }
            metaclass = type(f"Metaclass_{name}", (type,), functions)
            made = metaclass(name, (DefinedMessage,), {"store": self.store, "type_name": type_name})
            callbacks = _MessageCallbacks(
                f"{package}::{kind}".encode(),
                name.encode(),
                self.address(_OnSerialize(_guarded(_serialize))),
                self.address(_OnDeserialize(_guarded(functools.partial(_deserialize, made)))),
                self.address(_OnSize(_size)),
                self.address(_OnMaxSize(_max_size)),
            )
            support = _MessageSupport(_IDENTIFIER, self.address(callbacks), **self.about(type_name))
            support.find = self.address(_OnFind(self.finding(type_name, ctypes.addressof(support))))
            metaclass._TYPE_SUPPORT = self.capsule(support)  # type: ignore[attr-defined]
            self.classes[type_name] = made
        return self.classes[type_name]

    def finding(self, type_name: str, support: int) -> Callable[[int, bytes], int | None]:
        """Return the function that finds the table of a message by an identifier."""

        def find(_: int, identifier: bytes) -> int | None:
            if identifier == _INTROSPECTION.encode():
                return self.introspection(type_name)
            return support if identifier == _IDENTIFIER else None

        return find

    def introspection(self, type_name: str) -> int:
        """Return the table that describes the fields of a message, for the type object of its topic."""
        if type_name not in self.introspected:
            package, kind, name = type_name.split("/")
            fields = self.store.definition(type_name).fields or (_PLACEHOLDER,)
            members = [
                _Member(
                    self.keep(field.name.encode()),
                    _INTROSPECTION_IDS.get(field.type.base, _INTROSPECTION_MESSAGE),
                    field.type.text_bound,
                    self.introspection(field.type.base) if field.type.is_message else None,
                    is_array=field.type.many is not Many.ONE,
                    array_size=field.type.size,
                    is_bounded=field.type.many is Many.SEQUENCE and field.type.size > 0,
                )
                for field in fields
            ]
            described = _Members(
                f"{package}__{kind}".encode(),
                name.encode(),
                len(members),
                members=self.address((_Member * len(members))(*members)),
            )
            support = _MessageSupport(
                data=self.address(described), find=_find("message"), **self.about(type_name)
            )
            # The middleware compares the addresses of identifiers, not their texts.
            library = _library(f"lib{_INTROSPECTION}.so")
            identifier = ctypes.c_void_p.in_dll(library, f"{_INTROSPECTION}__identifier")
            ctypes.c_void_p.from_buffer(support).value = identifier.value
            self.introspected[type_name] = self.address(support)
        return self.introspected[type_name]

    def service(self, type_name: str) -> type:
        """Return the class of a service."""
        if type_name not in self.classes:
            package, kind, name = type_name.split("/")
            request, response = (self.message(f"{type_name}_{part}") for part in ("Request", "Response"))
            callbacks = _ServiceCallbacks(
                f"{package}::{kind}".encode(), name.encode(), _support(request), _support(response)
            )
            support = _ServiceSupport(
                _IDENTIFIER,
                self.address(callbacks),
                _find("service"),
                _support(request),
                _support(response),
                **self.about(type_name),
            )
            metaclass = type(f"Metaclass_{name}", (type,), {"_TYPE_SUPPORT": self.capsule(support)})
            self.classes[type_name] = metaclass(name, (), {"Request": request, "Response": response})
        return self.classes[type_name]

    def action(self, type_name: str) -> type:
        """Return the class of an action."""
        if type_name not in self.classes:
            cancel, status = (
                installed_class(type_of) for type_of in (wrappers.CANCEL_GOAL, wrappers.GOAL_STATUS_ARRAY)
            )
            send_goal, get_result = (
                self.service(f"{type_name}_{part}") for part in ("SendGoal", "GetResult")
            )
            feedback = self.message(f"{type_name}_FeedbackMessage")
            support = _ActionSupport(
                *(_support(kind) for kind in (send_goal, get_result, cancel, feedback, status)),
                **self.about(type_name),
            )
            name = type_name.split("/")[2]
            parts = {
                "SendGoalService": send_goal,
                "GetResultService": get_result,
                "FeedbackMessage": feedback,
                "CancelGoalService": cancel,
                "GoalStatusMessage": status,
            }
            metaclass = type(f"Metaclass_{name}", (type,), {"_TYPE_SUPPORT": self.capsule(support)})
            members = {part: self.message(f"{type_name}_{part}") for part in ("Goal", "Result", "Feedback")}
            self.classes[type_name] = metaclass(name, (), {**members, "Impl": type("Impl", (), parts)})
        return self.classes[type_name]

    def defined(self, type_name: str) -> type:
        """Return the class of a message, service or action."""
        kind, name = type_name.split("/")[1:]
        if kind == "msg" or "_" in name:
            return self.message(type_name)
        return self.service(type_name) if kind == "srv" else self.action(type_name)

    def capsule(self, made: Any) -> Any:
        new = ctypes.pythonapi.PyCapsule_New
        new.restype, new.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
        return new(self.address(made), None, None)


_of_store = functools.cache(_Made)


def defined_class(store: TypeStore, type_name: str) -> Any:
    """Return the class of a message, service or action, made from the definitions of `store`.

    Raises:
        UnknownType, UnsupportedType, BadDefinition: a definition is missing or cannot be used.
    """
    return _of_store(store).defined(type_name)


def installed_class(type_name: str) -> Any:
    """Return the class of a type with which the installed ROS was built; raises what importing it raises."""
    from rclpy.type_support import check_for_type_support  # noqa: PLC0415 - is only there where ROS is

    package, kind, name = type_name.split("/")
    cls = getattr(importlib.import_module(f"{package}.{kind}"), name)
    check_for_type_support(cls)
    return cls


def _class_of(store: TypeStore, type_name: str) -> Any:
    try:
        return installed_class(type_name)
    except Exception:  # noqa: BLE001 - a package that is absent, or built for another Python
        return defined_class(store, type_name)


def _support(made: Any) -> int:
    """Return the address of the table of a class."""
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, (ctypes.py_object, ctypes.c_char_p)
    capsule = type(made)._TYPE_SUPPORT
    name = ctypes.pythonapi.PyCapsule_GetName
    name.restype, name.argtypes = ctypes.c_char_p, (ctypes.py_object,)
    address: int = pointer(capsule, name(capsule))
    return address


@functools.cache
def _find(kind: str) -> int:
    """Return the function of rosidl that finds a table by its identifier."""
    function = getattr(_library("librosidl_runtime_c.so"), f"get_{kind}_typesupport_handle_function")
    return ctypes.cast(function, ctypes.c_void_p).value or 0


class _FastCdr:
    """Methods of `eprosima::fastcdr::Cdr` by their symbols; each takes the address of the object first."""

    def __init__(self, library: ctypes.CDLL) -> None:
        pointer = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
        write = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t)
        self.get_buffer_pointer = pointer(("_ZN8eprosima7fastcdr3Cdr18get_buffer_pointerEv", library))
        self.serialize_array = write(("_ZN8eprosima7fastcdr3Cdr15serialize_arrayEPKcm", library))


@functools.cache
def _cdr() -> _FastCdr:
    return _FastCdr(_library("libfastcdr.so.2"))


def _library(name: str) -> ctypes.CDLL:
    """Return a library that rclpy has loaded."""
    return ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_NOW)


def _create() -> int:
    return next(_ADDRESSES)


def _destroy(address: int) -> None:
    _messages.pop(address, None)


def _from_python(message: Any, address: int) -> bool:
    _messages[address] = message
    return True


def _size(address: int) -> int:
    return len(_messages[address].encoded()) - _HEADER_BYTES


def _max_size(bounds: Any) -> int:
    bounds[0] = _UNBOUNDED
    return _LEAST_BUFFER_BYTES


def _serialize(address: int, cdr: int) -> bool:
    payload = _messages[address].encoded()[_HEADER_BYTES:]
    _cdr().serialize_array(cdr, payload, len(payload))
    return True


def _deserialize(made: type[DefinedMessage], cdr: int, address: int) -> bool:
    buffer = _Buffer.from_address(_Cdr.from_address(cdr).buffer or 0)
    begin = _cdr().get_buffer_pointer(cdr)
    if begin is None or buffer.begin != begin:
        raise AdapterUnavailable(
            "the installed Fast CDR has another layout; set HANDOVER_ROS_ADAPTER=cyclone"
        )
    _messages[address] = made(cdr=ctypes.string_at(begin, buffer.size))
    return True


def _guarded(act: Callable[..., bool]) -> Callable[..., bool]:
    """Return `act`, which fails instead of raising: C cannot catch what Python raises."""

    def guarded(*arguments: Any) -> bool:
        try:
            return act(*arguments)
        except Exception:
            log.exception("a message of a defined type failed")
            return False

    return guarded
