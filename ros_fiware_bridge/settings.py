"""The settings of the ROS bridge, beside those that every component shares."""

import os
from typing import Any, Literal

from pydantic import Field

from handover.settings import MaybePath, Settings


def _ros_domain_id() -> Any:
    """Return what ROS 2 itself goes by, so that the bridge is where the robots are."""
    return os.environ.get("ROS_DOMAIN_ID") or 0


class BridgeSettings(Settings):
    """Which graph is joined, how, and which mapping is at work."""

    bridge_port: int = Field(54100, ge=1, le=65535, description="REST port of the ROS bridge")
    bridge_url: str | None = Field(
        None, description="where the broker reaches the ROS bridge; http://host:port of it if absent"
    )
    bridge_name: str = Field(
        "ros-bridge",
        pattern=r"^[A-Za-z0-9_.-]+$",
        description="tells several ROS bridges of one factory apart",
    )
    ros_mapping: MaybePath = Field(
        None, description="YAML file of the rules, or the name of a shipped one; no rules if absent"
    )
    ros_adapter: Literal["auto", "cyclone", "rclpy", "rosbridge"] = Field(
        "auto",
        description="what carries the ROS graph: cyclone (DDS from a wheel), rclpy, a rosbridge server, or "
        "auto: cyclone, and, where it is installed, rclpy for services of nodes on Fast DDS",
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
        description="where the rosbridge server is, if the adapter is rosbridge",
    )
    ros_most_bytes: int = Field(
        16 * 2**20, ge=1024, description="messages larger than this are refused, coming or going"
    )

    @property
    def url(self) -> str:
        """Return where the broker reaches the bridge."""
        return self.url_of(self.bridge_port, self.bridge_url)
