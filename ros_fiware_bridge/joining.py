"""Joins the ROS graph with the settings of the bridge."""

from ros_fiware_bridge.graph import joining
from ros_fiware_bridge.graph.join_settings import JoinSettings
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.settings import BridgeSettings
from ros_fiware_bridge.types.type_store import TypeStore


async def join(settings: BridgeSettings, store: TypeStore) -> RosGraph:
    """Join the graph. Raises `AdapterUnavailable` or `BadName`, which the user can correct."""
    asked = JoinSettings(
        node=settings.ros_node,
        namespace=settings.ros_namespace,
        domain_id=settings.ros_domain_id,
        interfaces=settings.ros_interfaces,
        peers=settings.ros_peers,
        max_message_bytes=settings.ros_max_message_bytes,
        rosbridge_url=settings.rosbridge_url,
    )
    return await joining.join(store, asked, settings.ros_adapter)
