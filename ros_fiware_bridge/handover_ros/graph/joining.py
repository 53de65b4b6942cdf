"""Joins the graph with an adapter: one of ours, or one of another package.

An adapter is an asynchronous function that joins a graph, as `Join` describes. Another package adds one with
an entry point, and `HANDOVER_ROS_ADAPTER` selects it by its name:

    [project.entry-points."handover.ros_adapters"]
    zenoh = "acme_zenoh.adapter:join"
"""

import importlib.util
from collections.abc import Awaitable, Callable, Mapping
from enum import StrEnum
from typing import TypeAlias

from handover.distribution import install_command
from handover.extensions import ExtensionPoint
from handover_ros.errors import AdapterUnavailable
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.port import RosGraph
from handover_ros.types.type_store import TypeStore

__all__ = ["ADAPTERS", "Adapter", "Join", "JoinSettings", "installed", "join", "load_adapter"]

Join: TypeAlias = Callable[[TypeStore, JoinSettings], Awaitable[RosGraph]]
"""Joins the graph. Raises `BadName` or `AdapterUnavailable`. The caller closes the graph."""


class Adapter(StrEnum):
    """The adapters of this package: our own DDS, rclpy, a rosbridge server, or (auto) the first two together.

    `auto` uses our own DDS for topics, and the middleware of the peer for each service or action, if rclpy is
    installed.
    """

    AUTO = "auto"
    CYCLONE = "cyclone"
    RCLPY = "rclpy"
    ROSBRIDGE = "rosbridge"


ADAPTERS = ExtensionPoint(
    "ROS adapter",
    "handover.ros_adapters",
    {
        Adapter.AUTO: "handover_ros.graph.mixed:join",
        Adapter.CYCLONE: "handover_ros.graph.cyclone.graph:CycloneGraph.join",
        Adapter.RCLPY: "handover_ros.graph.ros_installed.graph:RosInstalledGraph.join",
        Adapter.ROSBRIDGE: "handover_ros.graph.rosbridge.graph:RosbridgeGraph.join",
    },
)
_REQUIRED_MODULES: Mapping[str, tuple[str, ...]] = {
    Adapter.AUTO: ("cyclonedds", "rosbags"),
    Adapter.CYCLONE: ("cyclonedds", "rosbags"),
    Adapter.RCLPY: ("rclpy", "rosbags"),
    Adapter.ROSBRIDGE: ("rosbags",),
}
_INSTALL_EXTRA = f"install the extra: {install_command('ros')}"
_INSTALL_RCLPY = (
    f"on Linux with Python 3.11: {install_command('ros', 'ros-rclpy')}; elsewhere run "
    "the bridge where ROS 2 is installed and its setup.bash was sourced"
)


def installed() -> list[Adapter]:
    """Return our adapters whose libraries are installed."""
    return [adapter for adapter in Adapter if all(map(importlib.util.find_spec, _REQUIRED_MODULES[adapter]))]


def load_adapter(name: str) -> Join:
    """Return the adapter `name`.

    Raises:
        UnknownExtension: there is no adapter of this name, or it cannot be imported.
        AdapterUnavailable: the library of the adapter is not installed.
    """
    if name in ADAPTERS.own and Adapter(name) not in installed():
        way = _INSTALL_RCLPY if name == Adapter.RCLPY else _INSTALL_EXTRA
        raise AdapterUnavailable(f"the adapter {name} is not installed; {way}")
    adapter: Join = ADAPTERS.load(name)
    return adapter


async def join(store: TypeStore, settings: JoinSettings, adapter: str = Adapter.AUTO) -> RosGraph:
    """Join the graph; the caller closes it.

    Raises:
        BadName: the node or its namespace has an invalid name.
        UnknownExtension, AdapterUnavailable: see `load_adapter`; or the network cannot be opened.
    """
    return await load_adapter(adapter)(store, settings)
