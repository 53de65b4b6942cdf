"""Quality of service between ROS and DDS."""

from typing import Any

from ros_fiware_bridge.graph.qos import Durability, History, Qos, Reliability

_MOST_BLOCKING_NS = 100_000_000
_READER_PLACES = 256
"""A reader keeps at least as many samples until they are taken: the depth that was asked for is kept, and
what it costs is counted, where they wait for the loop.
"""


def of_writer(qos: Qos, user_data: bytes) -> Any:
    """Return the DDS policies of a writer."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    policies: list[Any] = [Policy.WriterDataLifecycle(autodispose=False)]
    if qos.durability is Durability.TRANSIENT_LOCAL:
        # How much a late reader is given stands here, not in the history of the writer.
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
    history = Policy.History.KeepAll if all_of_it else Policy.History.KeepLast(max(qos.depth, _READER_PLACES))
    return _policies(qos, user_data, history, [])


def _policies(qos: Qos, user_data: bytes, history: Any, more: list[Any]) -> Any:
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy
    from cyclonedds.qos import Qos as DdsQos  # noqa: PLC0415

    reliable = qos.reliability is Reliability.RELIABLE
    late = qos.durability is Durability.TRANSIENT_LOCAL
    return DdsQos(
        Policy.Reliability.Reliable(_MOST_BLOCKING_NS) if reliable else Policy.Reliability.BestEffort,
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
    """Return what a peer's endpoint offers or wants (its history is not told over DDS)."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    best_effort = policies[Policy.Reliability] == Policy.Reliability.BestEffort
    volatile = policies[Policy.Durability] == Policy.Durability.Volatile
    return Qos(
        Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE,
        Durability.VOLATILE if volatile else Durability.TRANSIENT_LOCAL,
    )


def told(policies: Any) -> bytes:
    """Return the user data of a peer's participant or endpoint."""
    from cyclonedds.qos import Policy  # noqa: PLC0415 - heavy

    found = policies[Policy.Userdata]
    return bytes(found.data) if found is not None else b""
