"""Joins the ROS graph with the settings of the bridge."""

from pathlib import Path

from handover_ros.graph import joining
from handover_ros.graph.join_settings import JoinSettings
from handover_ros.graph.port import RosGraph
from handover_ros.settings import BridgeSettings
from handover_ros.types.type_store import TypeStore


async def join(settings: BridgeSettings, store: TypeStore, *, goals_file: Path | None = None) -> RosGraph:
    """Join the graph. Raises `AdapterUnavailable` or `BadName`, which the user can correct.

    Only the bridge itself has a `goals_file`: another program with the same one would cancel its goals.
    """
    asked = JoinSettings(
        node=settings.ros_node,
        namespace=settings.ros_namespace,
        domain_id=settings.ros_domain_id,
        interfaces=settings.ros_interfaces,
        peers=settings.ros_peers,
        max_message_bytes=settings.ros_max_message_bytes,
        rosbridge_url=settings.rosbridge_url,
        goals_file=goals_file,
    )
    return await joining.join(store, asked, settings.ros_adapter)
