"""Joining: the ROS graph that the settings name, over the adapter that they name."""

from ros_fiware_bridge.graph import joining
from ros_fiware_bridge.graph.joining import Adapter, JoinSettings
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.settings import BridgeSettings
from ros_fiware_bridge.types.type_store import TypeStore


async def join(settings: BridgeSettings, store: TypeStore) -> RosGraph:
    """Join the graph. Raises `AdapterUnavailable`, `BadName`, which a person can mend."""
    asked = JoinSettings(
        node=settings.ros_node,
        namespace=settings.ros_namespace,
        domain_id=settings.ros_domain_id,
        interfaces=settings.ros_interfaces,
        peers=settings.ros_peers,
        most_bytes=settings.ros_most_bytes,
        rosbridge_url=settings.rosbridge_url,
    )
    return await joining.join(store, asked, Adapter(settings.ros_adapter))
