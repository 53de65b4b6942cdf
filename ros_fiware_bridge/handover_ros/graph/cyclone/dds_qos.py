"""Conversion of quality of service between ROS and DDS."""

from typing import Any

from handover_ros.graph.qos import Durability, History, Qos, Reliability

_MAX_BLOCKING_NS = 100_000_000
_MIN_READER_DEPTH = 256
"""The minimum number of samples that a reader keeps until they are taken. `Inbox` applies the depth of the
subscription, and counts what it drops.
"""


def of_writer(qos: Qos, user_data: bytes) -> Any:
    """Return the DDS policies of a writer."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    policies: list[Any] = [Policy.WriterDataLifecycle(autodispose=False)]
    if qos.durability is Durability.TRANSIENT_LOCAL:
        # The durability service determines what a late reader receives, not the history of the writer.
        policies.append(
            Policy.DurabilityService(
                cleanup_delay=0,
                history=_history(qos),
                max_samples=-1,
                max_instances=-1,
                max_samples_per_instance=-1,
            )
        )
    return _policies(qos, user_data, _history(qos), policies)


def of_reader(qos: Qos, user_data: bytes) -> Any:
    """Return the DDS policies of a reader."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    all_of_it = qos.history is History.KEEP_ALL
    history = (
        Policy.History.KeepAll if all_of_it else Policy.History.KeepLast(max(qos.depth, _MIN_READER_DEPTH))
    )
    return _policies(qos, user_data, history, [])


def _policies(qos: Qos, user_data: bytes, history: Any, more: list[Any]) -> Any:
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy
    from cyclonedds.qos import Qos as DdsQos  # noqa: PLC0415

    reliable = qos.reliability is Reliability.RELIABLE
    late = qos.durability is Durability.TRANSIENT_LOCAL
    return DdsQos(
        Policy.Reliability.Reliable(_MAX_BLOCKING_NS) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if late else Policy.Durability.Volatile,
        history,
        # ROS 2 speaks XCDR1; without this the binding may choose XCDR2.
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data),
        *more,
    )


def _history(qos: Qos) -> Any:
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    return Policy.History.KeepAll if qos.history is History.KEEP_ALL else Policy.History.KeepLast(qos.depth)


def offered(policies: Any) -> Qos:
    """Return the QoS that a peer's endpoint offers or requests (DDS does not transmit its history)."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    best_effort = policies[Policy.Reliability] == Policy.Reliability.BestEffort
    volatile = policies[Policy.Durability] == Policy.Durability.Volatile
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.VOLATILE if volatile else Durability.TRANSIENT_LOCAL,
    )


def user_data_of(policies: Any) -> bytes:
    """Return the user data of a peer's participant or endpoint."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    user_data = policies[Policy.Userdata]
    return bytes(user_data.data) if user_data is not None else b""
