"""The settings of the ROS bridge, in addition to those that every component shares."""

import os
from typing import Any

from pydantic import Field

from handover.extensions import Service
from handover.service_addresses import ROS_BRIDGE, BridgeAddress
from handover.settings import Settings


def _ros_domain_id() -> Any:
    """Return the domain that ROS 2 itself would use."""
    return os.environ.get("ROS_DOMAIN_ID") or 0


class BridgeSettings(BridgeAddress, Settings):
    """The graph to join, the adapter, and the mapping."""

    bridge_name: str = Field(
        "ros-bridge",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="distinguishes several ROS bridges of one factory",
    )
    ros_adapter: str = Field(
        "auto",
        min_length=1,
        description="the graph adapter: cyclone (DDS from a wheel), rclpy, a rosbridge server, or "
        "auto: cyclone, and rclpy for services of nodes on Fast DDS, where it is installed; or a plug-in",
    )
    ros_domain_id: int = Field(
        default_factory=_ros_domain_id,
        validate_default=True,
        ge=0,
        le=232,
        description="the ROS domain; ROS_DOMAIN_ID if absent",
    )
    ros_node: str = Field("handover_bridge", description="the name of the bridge's node")
    ros_namespace: str = Field("/", description="the namespace of the bridge's node")
    ros_interfaces: tuple[str, ...] = Field(
        (), description="network interfaces to use, as JSON; the preferred one and loopback if absent"
    )
    ros_peers: tuple[str, ...] = Field(
        (), description="addresses of robots that multicast does not reach, as JSON"
    )
    rosbridge_url: str = Field(
        "ws://127.0.0.1:9090",
        pattern=r"^wss?://",
        description="address of the rosbridge server, for the adapter rosbridge",
    )
    ros_max_message_bytes: int = Field(
        16 * 2**20, ge=1024, description="size limit of a message in bytes, sent or received"
    )

    @property
    def url(self) -> str:
        """Return the address at which the broker reaches the bridge."""
        return self.ros_bridge


SERVICE = Service(
    ROS_BRIDGE,
    "handover_ros",
    BridgeSettings,
    "bridge_port",
    runs_if=lambda: BridgeSettings.load().ros_mapping is not None,
)
