"""The settings of the web UI server: its own port, and the addresses of the services."""

import ipaddress
from collections.abc import Mapping
from urllib.parse import urlsplit

from pydantic import Field, SecretStr

from handover.settings import MaybePath, Names, Settings

BROKER = "context-broker"
ORCHESTRATOR = "task-orchestrator"
CONTROLLER = "gesture-controller"
TRAJECTORY = "trajectory-tool"
STUDY = "study"
ALERT_ROUTER = "alert-router"
ACCOUNTS = "accounts"
GATEWAY = "device-gateway"
HUMAN_STATE = "human-state"
ASSISTIVE_DEVICES = "assistive-devices"
WHOLE_BODY_CONTROL = "whole-body-control"
ROS_BRIDGE = "ros-bridge"


class WebuiSettings(Settings):
    """The settings of the web UI server."""

    webui_port: int = Field(54400, ge=1, le=65535, description="the port of the web UI")
    webui_url: str | None = Field(
        None,
        description="where the broker reaches the web UI; http://host:port of it if absent",
    )
    cell_tenants: Names = Field(
        (), description="tenants of the broker whose cells the page lists besides those of its own"
    )
    emergency_stop: str | None = Field(
        None,
        max_length=120,
        description="the location of the emergency stop, as shown on the Work page; the red button on the "
        "cell if absent",
    )
    controller_port: int = Field(
        54210, ge=1, le=65535, description="REST and WebSocket port of the controller"
    )
    controller_url: str | None = Field(
        None,
        description="where the broker reaches the controller; http://host:port of it if absent",
    )
    trajectory_port: int = Field(54220, ge=1, le=65535, description="REST and WebSocket port of the tool")
    trajectory_url: str | None = Field(
        None,
        description="where the broker reaches the trajectory tool; http://host:port of it if absent",
    )
    alert_router_port: int = Field(54280, ge=1, le=65535, description="REST port of the alert router")
    alert_router_url: str | None = Field(
        None, description="where the broker reaches the alert router; http://host:port of it if absent"
    )
    study_port: int = Field(54270, ge=1, le=65535, description="REST port of the study service")
    study_url: str | None = Field(
        None, description="the URL of the study service for others; by default http://host:port"
    )
    gateway_port: int = Field(54240, ge=1, le=65535, description="REST port of the device gateway")
    gateway_url: str | None = Field(
        None, description="where the broker reaches the device gateway; http://host:port of it if absent"
    )
    human_state_port: int = Field(54250, ge=1, le=65535, description="REST and WebSocket port of human state")
    human_state_url: str | None = Field(
        None, description="where others reach human state; http://host:port of it if absent"
    )
    assistive_port: int = Field(54290, ge=1, le=65535, description="REST port of assistive devices")
    assistive_url: str | None = Field(
        None, description="where others reach assistive devices; http://host:port of it if absent"
    )
    whole_body_port: int = Field(54260, ge=1, le=65535, description="REST and WebSocket port of humanoids")
    whole_body_url: str | None = Field(
        None, description="where others reach whole-body control; http://host:port of it if absent"
    )
    bridge_port: int = Field(54100, ge=1, le=65535, description="REST port of the ROS bridge")
    bridge_url: str | None = Field(
        None,
        description="where the broker reaches the ROS bridge; http://host:port of it if absent",
    )
    ros_mapping: MaybePath = Field(
        None, description="YAML file of the rules, or the name of a shipped one; no rules if absent"
    )
    glove_host: str = Field("127.0.0.1", description="the address on which gloves are awaited")
    glove_port: int = Field(54000, ge=1, le=65535, description="the TCP port on which gloves are awaited")
    glove_token: SecretStr | None = Field(
        None, description="what a glove must say to be let in; required when glove_host is not loopback"
    )

    @property
    def own_url(self) -> str:
        """The URL at which the broker reaches this server."""
        return self.url_of(self.webui_port, self.webui_url)

    @property
    def public_url(self) -> str:
        """The URL at which people open the page: of the proxy, by the first allowed host, or its own."""
        if self.tls_proxy_url:
            return self.tls_proxy_url.rstrip("/")
        own = urlsplit(self.own_url)
        host = self.allowed_hosts[0] if self.allowed_hosts else own.hostname
        if host in {"0.0.0.0", "::"}:  # noqa: S104 - not bound
            host = "127.0.0.1"
        name = f"[{host}]" if host and ":" in host else host
        return f"{own.scheme}://{name}:{own.port}" if own.port else f"{own.scheme}://{name}"

    @property
    def service_urls(self) -> Mapping[str, str]:
        """The URL of each service, by its name; the ROS bridge only if `ros_mapping` is set."""
        urls = {
            BROKER: self.broker_url,
            ORCHESTRATOR: self.url_of(self.orchestrator_port, self.orchestrator_url),
            CONTROLLER: self.url_of(self.controller_port, self.controller_url),
            TRAJECTORY: self.url_of(self.trajectory_port, self.trajectory_url),
            GATEWAY: self.url_of(self.gateway_port, self.gateway_url),
            ALERT_ROUTER: self.url_of(self.alert_router_port, self.alert_router_url),
            STUDY: self.url_of(self.study_port, self.study_url),
            HUMAN_STATE: self.url_of(self.human_state_port, self.human_state_url),
            ASSISTIVE_DEVICES: self.url_of(self.assistive_port, self.assistive_url),
            WHOLE_BODY_CONTROL: self.url_of(self.whole_body_port, self.whole_body_url),
            ACCOUNTS: self.accounts,
        }
        if self.ros_mapping is not None:
            urls[ROS_BRIDGE] = self.url_of(self.bridge_port, self.bridge_url)
        return urls

    @property
    def glove_server_host(self) -> str:
        """The host to which a glove on this machine connects.

        If the controller listens for gloves on all its addresses or on loopback, this is the host of its URL.
        """
        behind_url = urlsplit(self.service_urls[CONTROLLER]).hostname or self.glove_host
        try:
            address = ipaddress.ip_address(self.glove_host)
        except ValueError:
            return behind_url if self.glove_host == "localhost" else self.glove_host
        return behind_url if address.is_unspecified or address.is_loopback else self.glove_host
