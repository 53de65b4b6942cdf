"""Joining: the ROS graph that the settings name, through the adapter that they name."""

from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.settings import BridgeSettings
from ros_fiware_bridge.types.type_store import TypeStore


async def join(settings: BridgeSettings, store: TypeStore) -> RosGraph:
    """Join the graph. Raises `AdapterUnavailable`, `BadName`, which a person can mend."""
    from ros_fiware_bridge.graph.cyclone.domain import DomainSettings  # noqa: PLC0415 - only this adapter
    from ros_fiware_bridge.graph.cyclone.graph import CycloneGraph, CycloneSettings  # noqa: PLC0415

    return await CycloneGraph.join(
        store,
        CycloneSettings(
            node=settings.ros_node,
            namespace=settings.ros_namespace,
            domain=DomainSettings(
                domain_id=settings.ros_domain_id,
                interfaces=settings.ros_interfaces,
                peers=settings.ros_peers,
            ),
            most_bytes=settings.ros_most_bytes,
        ),
    )
