"""Joins the graph with one of the installed adapters."""

import importlib.util
from dataclasses import dataclass, replace
from enum import StrEnum

from ros_fiware_bridge.errors import AdapterUnavailable
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.types.type_store import TypeStore

DEFAULT_MAX_MESSAGE_BYTES = 16 * 2**20


class Adapter(StrEnum):
    """The adapters: our own DDS, rclpy, a rosbridge server, or (auto) the first two together.

    `auto` uses our own DDS for topics, and the middleware of the peer for each service or action, if rclpy is
    installed.
    """

    AUTO = "auto"
    CYCLONE = "cyclone"
    RCLPY = "rclpy"
    ROSBRIDGE = "rosbridge"


@dataclass(frozen=True, slots=True)
class JoinSettings:
    """The node and the network of the bridge.

    `interfaces` (names or addresses; default: the network that the machine prefers, and loopback), `peers`
    (addresses for unicast discovery, where multicast does not reach) and `multicast` apply to Cyclone DDS; an
    installed ROS has its own settings for these. `rosbridge_url` is the address of a rosbridge server.
    `max_message_bytes` is the size limit of messages in both directions.
    """

    node: str = "handover_bridge"
    namespace: str = "/"
    enclave: str = "/"
    domain_id: int = 0
    interfaces: tuple[str, ...] = ()
    peers: tuple[str, ...] = ()
    multicast: bool = True
    max_message_bytes: int = DEFAULT_MAX_MESSAGE_BYTES
    rosbridge_url: str = "ws://127.0.0.1:9090"


def installed() -> list[Adapter]:
    """Return the adapters whose libraries are installed."""
    needs = {
        Adapter.AUTO: ("cyclonedds", "rosbags"),
        Adapter.CYCLONE: ("cyclonedds", "rosbags"),
        Adapter.RCLPY: ("rclpy", "rosbags"),
        Adapter.ROSBRIDGE: ("rosbags",),
    }
    return [one for one in Adapter if all(importlib.util.find_spec(name) for name in needs[one])]


async def join(store: TypeStore, settings: JoinSettings, adapter: Adapter = Adapter.AUTO) -> RosGraph:
    """Join the graph; the caller closes it.

    Raises:
        BadName: the node or its namespace has an invalid name.
        AdapterUnavailable: the adapter's library is not installed, or the domain cannot be opened.
    """
    if adapter not in installed():
        way = {
            Adapter.AUTO: "install the extra: pip install 'handover[ros]'",
            Adapter.CYCLONE: "install the extra: pip install 'handover[ros]'",
            Adapter.ROSBRIDGE: "install the extra: pip install 'handover[ros]'",
            Adapter.RCLPY: "on Linux with Python 3.11: pip install 'handover[ros,ros-rclpy]'; elsewhere run "
            "the bridge where ROS 2 is installed and its setup.bash was sourced",
        }
        raise AdapterUnavailable(f"the adapter {adapter.value} is not installed; {way[adapter]}")
    if adapter is Adapter.RCLPY:
        return (await _join_rclpy(store, settings))[0]
    if adapter is Adapter.ROSBRIDGE:
        from ros_fiware_bridge.graph.rosbridge.graph import RosbridgeGraph  # noqa: PLC0415 - if chosen

        return await RosbridgeGraph.join(store, settings)
    from ros_fiware_bridge.graph.cyclone.graph import CycloneGraph  # noqa: PLC0415 - if chosen

    own = await CycloneGraph.join(store, settings)
    if adapter is Adapter.CYCLONE or Adapter.RCLPY not in installed():
        return own
    from ros_fiware_bridge.graph.mixed import MixedGraph  # noqa: PLC0415 - if chosen

    beside = replace(settings, node=f"{settings.node}_rclpy")
    return MixedGraph(own, lambda: _join_rclpy(store, beside))


async def _join_rclpy(store: TypeStore, settings: JoinSettings) -> tuple[RosGraph, str]:
    from ros_fiware_bridge.graph.ros_installed.graph import RosInstalledGraph  # noqa: PLC0415 - if chosen

    graph = await RosInstalledGraph.join(store, settings)
    return graph, graph.middleware
