"""Where the services of a cell are: a part of the settings for each service that others ask.

A service has the addresses of itself and of the services that it asks, so that a port is declared once:

    class StudySettings(StudyAddress, ControllerAddress, Settings): ...

The parts are no models themselves: each model takes a process 10 ms and 0.4 MB.

`accounts` and `orchestrator`, which all services ask, are in `handover.settings.Settings`.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from pydantic import Field, SecretStr

from handover.settings import MaybePath

if TYPE_CHECKING:
    from handover.settings import Settings as _Part
else:
    _Part = object

BROKER: Final = "context-broker"
ORCHESTRATOR: Final = "task-orchestrator"
GESTURE_CONTROLLER: Final = "gesture-controller"
TRAJECTORY: Final = "trajectory-tool"
STUDY: Final = "study"
ALERT_ROUTER: Final = "alert-router"
ACCOUNTS: Final = "accounts"
DEVICE_GATEWAY: Final = "device-gateway"
HUMAN_STATE: Final = "human-state"
ASSISTIVE_DEVICES: Final = "assistive-devices"
WHOLE_BODY_CONTROL: Final = "whole-body-control"
ROS_BRIDGE: Final = "ros-bridge"
WEBUI: Final = "webui"
OWN_SERVICES: Final = (
    BROKER,
    ORCHESTRATOR,
    GESTURE_CONTROLLER,
    TRAJECTORY,
    DEVICE_GATEWAY,
    ALERT_ROUTER,
    ACCOUNTS,
    STUDY,
    WEBUI,
    HUMAN_STATE,
    ASSISTIVE_DEVICES,
    WHOLE_BODY_CONTROL,
    ROS_BRIDGE,
)
"""The names of our services, in the order in which they start."""


class ControllerAddress(_Part):
    """The address of the gesture controller."""

    controller_port: int = Field(
        54210, ge=1, le=65535, description="REST and WebSocket port of the gesture controller"
    )
    controller_url: str | None = Field(
        None, description="where others reach the gesture controller; http://host:port of it if absent"
    )

    @property
    def gesture_controller(self) -> str:
        """The URL of the gesture controller."""
        return self.url_of(self.controller_port, self.controller_url)


class GloveServerAddress(_Part):
    """The address at which the gesture controller waits for gloves."""

    glove_host: str = Field("127.0.0.1", description="the address of the glove server")
    glove_port: int = Field(54000, ge=1, le=65535, description="the TCP port of the glove server")
    glove_token: SecretStr | None = Field(
        None,
        description="the token of this site, for gloves without one of their own; if absent, those need none "
        "where only this machine reaches glove_host, and are refused elsewhere",
    )


class TrajectoryAddress(_Part):
    """The address of the trajectory tool."""

    trajectory_port: int = Field(
        54220, ge=1, le=65535, description="REST and WebSocket port of the trajectory tool"
    )
    trajectory_url: str | None = Field(
        None, description="where others reach the trajectory tool; http://host:port of it if absent"
    )

    @property
    def trajectory_tool(self) -> str:
        """The URL of the trajectory tool."""
        return self.url_of(self.trajectory_port, self.trajectory_url)


class GatewayAddress(_Part):
    """The address of the device gateway."""

    gateway_port: int = Field(54240, ge=1, le=65535, description="REST port of the device gateway")
    gateway_url: str | None = Field(
        None, description="where others reach the device gateway; http://host:port of it if absent"
    )

    @property
    def device_gateway(self) -> str:
        """The URL of the device gateway."""
        return self.url_of(self.gateway_port, self.gateway_url)


class HumanStateAddress(_Part):
    """The address of human state."""

    human_state_port: int = Field(54250, ge=1, le=65535, description="REST and WebSocket port of human state")
    human_state_url: str | None = Field(
        None, description="where others reach human state; http://host:port of it if absent"
    )

    @property
    def human_state(self) -> str:
        """The URL of human state."""
        return self.url_of(self.human_state_port, self.human_state_url)


class WholeBodyAddress(_Part):
    """The address of whole-body control."""

    whole_body_port: int = Field(
        54260, ge=1, le=65535, description="REST and WebSocket port of whole-body control"
    )
    whole_body_url: str | None = Field(
        None, description="where others reach whole-body control; http://host:port of it if absent"
    )

    @property
    def whole_body_control(self) -> str:
        """The URL of whole-body control."""
        return self.url_of(self.whole_body_port, self.whole_body_url)


class StudyAddress(_Part):
    """The address of the study service."""

    study_port: int = Field(54270, ge=1, le=65535, description="REST port of the study service")
    study_url: str | None = Field(
        None, description="where others reach the study service; http://host:port of it if absent"
    )

    @property
    def study(self) -> str:
        """The URL of the study service."""
        return self.url_of(self.study_port, self.study_url)


class AlertRouterAddress(_Part):
    """The address of the alert router."""

    alert_router_port: int = Field(54280, ge=1, le=65535, description="REST port of the alert router")
    alert_router_url: str | None = Field(
        None, description="where others reach the alert router; http://host:port of it if absent"
    )

    @property
    def alert_router(self) -> str:
        """The URL of the alert router."""
        return self.url_of(self.alert_router_port, self.alert_router_url)


class AssistiveAddress(_Part):
    """The address of assistive devices."""

    assistive_port: int = Field(54290, ge=1, le=65535, description="REST port of assistive devices")
    assistive_url: str | None = Field(
        None, description="where others reach assistive devices; http://host:port of it if absent"
    )

    @property
    def assistive_devices(self) -> str:
        """The URL of assistive devices."""
        return self.url_of(self.assistive_port, self.assistive_url)


class BridgeAddress(_Part):
    """The address of the ROS bridge."""

    bridge_port: int = Field(54100, ge=1, le=65535, description="REST port of the ROS bridge")
    bridge_url: str | None = Field(
        None, description="where others reach the ROS bridge; http://host:port of it if absent"
    )
    ros_mapping: MaybePath = Field(
        None, description="YAML file of the rules, or the name of a shipped one; no rules if absent"
    )

    @property
    def ros_bridge(self) -> str:
        """The URL of the ROS bridge."""
        return self.url_of(self.bridge_port, self.bridge_url)


class PageAddress(_Part):
    """The address of the page."""

    webui_port: int = Field(54400, ge=1, le=65535, description="the port of the web UI")
    webui_url: str | None = Field(
        None, description="where the broker reaches the web UI; http://host:port of it if absent"
    )

    @property
    def webui(self) -> str:
        """The URL of the page's server on this machine or in the cell's network."""
        return self.url_of(self.webui_port, self.webui_url)

    @property
    def public_url(self) -> str:
        """The URL at which people open the page: of the proxy, by the first allowed host, or its own."""
        if self.tls_proxy_url:
            return self.tls_proxy_url.rstrip("/")
        own = urlsplit(self.webui)
        host = self.allowed_hosts[0] if self.allowed_hosts else own.hostname
        if host in {"0.0.0.0", "::"}:  # noqa: S104 - not bound
            host = "127.0.0.1"
        name = f"[{host}]" if host and ":" in host else host
        return f"{own.scheme}://{name}:{own.port}" if own.port else f"{own.scheme}://{name}"


class CellAddresses(
    PageAddress,
    ControllerAddress,
    GloveServerAddress,
    TrajectoryAddress,
    GatewayAddress,
    HumanStateAddress,
    WholeBodyAddress,
    StudyAddress,
    AlertRouterAddress,
    AssistiveAddress,
    BridgeAddress,
):
    """The addresses of all services."""

    @property
    def service_urls(self) -> Mapping[str, str]:
        """The URL of each service, by its name; the ROS bridge only if `ros_mapping` is set."""
        urls = {
            BROKER: self.broker_url,
            ORCHESTRATOR: self.orchestrator,
            GESTURE_CONTROLLER: self.gesture_controller,
            TRAJECTORY: self.trajectory_tool,
            DEVICE_GATEWAY: self.device_gateway,
            ALERT_ROUTER: self.alert_router,
            STUDY: self.study,
            HUMAN_STATE: self.human_state,
            ASSISTIVE_DEVICES: self.assistive_devices,
            WHOLE_BODY_CONTROL: self.whole_body_control,
            ACCOUNTS: self.accounts,
        }
        if self.ros_mapping is not None:
            urls[ROS_BRIDGE] = self.ros_bridge
        return urls
