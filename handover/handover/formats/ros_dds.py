"""ROS 2 topics over DDS for services that must not wait for the bridge: their types, names and endpoints.

The bridge maps a ROS graph to the broker and knows every type. A service that reads a waveform or commands
a machine at its control rate joins the domain by itself, with the few types that it needs. Types are named as
rosidl names them: final structs in XCDR1, `std_msgs/msg/Header` as `std_msgs::msg::dds_::Header_`. Needs the
extra `ros`; everything here raises `UsageError` without it.
"""

from collections.abc import Iterable
from typing import Any, Final

from handover.distribution import install_command
from handover.errors import UsageError

MAX_DOMAIN: Final = 232
MAX_PUBLISHED: Final = 4096
Fields = Iterable[tuple[str, Any]]
"""Name and kind of each field, in order: `float64`, `str[]`, or a struct made by `struct_of`."""


def struct_of(ros_type: str, fields: Fields) -> Any:
    """Return the DDS type of a ROS type, such as `geometry_msgs/msg/Twist`."""
    require_extra()
    from cyclonedds.idl import make_idl_struct  # noqa: PLC0415 - of the extra

    package, name = ros_type.split("/msg/")
    type_name = f"{package}::msg::dds_::{name}_"
    kinds = {field: _kind_of(kind) for field, kind in fields}
    made = make_idl_struct(type_name.replace("::", "_"), type_name, kinds)
    made.__idl_annotations__["extensibility"] = "final"
    return made


class TopicEndpoints:
    """Readers and writers in one ROS domain. Raises `OSError` if it cannot be joined."""

    def __init__(self, domain: int) -> None:
        require_extra()
        from cyclonedds.core import DDSException  # noqa: PLC0415 - of the extra
        from cyclonedds.domain import DomainParticipant  # noqa: PLC0415

        self.failure: Final[type[Exception]] = DDSException
        """What calls of readers and writers raise."""
        try:
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            raise OSError(f"the ROS domain {domain} cannot be joined: {error}") from error

    def reader(self, name: str, struct: Any, *, depth: int) -> Any:
        """Return a reader of the ROS topic `name`; best effort matches publishers of either kind."""
        from cyclonedds.qos import Policy  # noqa: PLC0415 - of the extra
        from cyclonedds.sub import DataReader  # noqa: PLC0415

        return DataReader(
            self._participant, self._topic(name, struct), qos=_qos(Policy.Reliability.BestEffort, depth)
        )

    def published(self) -> list[tuple[str, str]]:
        """Return the ROS topics that are published now, each with its type: `/ecg`, `pkg/msg/Ecg`.

        Publishers that joined just before may be missing.
        """
        from cyclonedds.builtin import (  # noqa: PLC0415 - of the extra
            BuiltinDataReader,
            BuiltinTopicDcpsPublication,
        )

        publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication).read(N=MAX_PUBLISHED)
        return sorted(
            {
                (publication.topic_name.removeprefix("rt"), _ros_name(publication.type_name))
                for publication in publications
                if getattr(publication, "topic_name", "").startswith("rt/")
            }
        )

    def writer(self, name: str, struct: Any, *, max_blocking_ns: int) -> Any:
        """Return a reliable writer of the newest message, which matches subscribers of either kind."""
        from cyclonedds.pub import DataWriter  # noqa: PLC0415 - of the extra
        from cyclonedds.qos import Policy  # noqa: PLC0415

        reliability = Policy.Reliability.Reliable(max_blocking_ns)
        return DataWriter(self._participant, self._topic(name, struct), qos=_qos(reliability, 1))

    def _topic(self, name: str, struct: Any) -> Any:
        from cyclonedds.topic import Topic  # noqa: PLC0415 - of the extra

        return Topic(self._participant, f"rt/{name.removeprefix('/')}", struct)


def _ros_name(dds_type: str) -> str:
    """Return `std_msgs/msg/Header` of `std_msgs::msg::dds_::Header_`; others as they are."""
    package, _, name = dds_type.partition("::msg::dds_::")
    return f"{package}/msg/{name.removesuffix('_')}" if name else dds_type


def _qos(reliability: Any, depth: int) -> Any:
    from cyclonedds.qos import Policy, Qos  # noqa: PLC0415 - of the extra

    # ROS 2 speaks XCDR1; without this the binding may choose XCDR2.
    return Qos(
        reliability, Policy.History.KeepLast(depth), Policy.DataRepresentation(use_cdrv0_representation=True)
    )


def _kind_of(kind: Any) -> Any:
    import cyclonedds.idl.types as described  # noqa: PLC0415 - of the extra

    types: Any = described  # its classes are indexed by values that mypy cannot follow
    if not isinstance(kind, str):
        return kind
    if kind.endswith("[]"):
        return types.sequence[_kind_of(kind.removesuffix("[]"))]
    return {"str": str, "bool": bool}.get(kind) or getattr(types, kind)


def require_extra() -> None:
    """Raise `UsageError` where DDS is not installed."""
    try:
        import cyclonedds.core  # noqa: F401, PLC0415 - of the extra
    except ImportError:
        raise UsageError(f"ROS topics need the extra: {install_command('ros')}") from None
