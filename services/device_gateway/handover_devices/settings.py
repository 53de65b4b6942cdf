"""The settings of the device gateway, in addition to the common ones."""

import socket
from pathlib import Path
from typing import ClassVar

from pydantic import Field, SecretStr

from handover.extensions import Service
from handover.service_addresses import DEVICE_GATEWAY, GatewayAddress, TrajectoryAddress
from handover.settings import MaybePath, Settings
from handover.transport_security.local_authority import AUTHORITY


class GatewaySettings(GatewayAddress, TrajectoryAddress, Settings):
    """Addresses, limits and retention of the device gateway."""

    removed: ClassVar = {
        "device_hello_timeout_s": "a device has 5 s to send its hello",
        "device_ack_timeout_s": "a command without an answer for 2 s is sent again, if its kind allows it",
    }

    gateway_replica_host: str | None = Field(
        None,
        description="the address at which other replicas of the device gateway reach this one, where several "
        "run on one PostgreSQL database; the address on which devices connect if absent",
    )
    device_host: str = Field("127.0.0.1", description="the address on which devices connect")
    device_port: int = Field(54010, ge=1, le=65535, description="the TCP or TLS port for devices")
    device_tls_certificate: MaybePath = Field(
        None,
        description="PEM file of the certificate chain for devices; that of the service if absent",
    )
    device_tls_key: MaybePath = Field(None, description="PEM file of the private key of that certificate")
    device_client_authority: MaybePath = Field(
        None,
        description="PEM file of the authorities whose certificates devices may show instead of a token; "
        "that of `handover secure` if absent",
    )
    device_plain: bool = Field(
        False,
        description="allow devices beyond this machine without TLS: behind a proxy that ends TLS, or in a "
        "network that is trusted",
    )
    device_mqtt_url: str | None = Field(
        None,
        description="an MQTT 5 server for devices, such as mqtts://user@host:8883; none if absent",
    )
    device_mqtt_password: SecretStr | None = Field(
        None, description="the password of the gateway at the MQTT server"
    )
    device_mqtt_topic: str = Field(
        "handover",
        pattern=r"^[^/+#\s\x00]+(/[^/+#\s\x00]+)*$",
        max_length=200,
        description="the first part of the topics of devices",
    )
    device_rules: MaybePath = Field(
        None, description="YAML file of rules for anomalies; rules can be added by REST as well"
    )
    device_idle_timeout_s: float = Field(
        60.0, gt=0, description="a device that sends nothing for this time is disconnected"
    )
    device_max_connections: int = Field(2000, ge=1, description="maximum connections of devices")
    device_max_messages_per_s: float = Field(
        200.0, gt=0, description="rate of messages of one device; the gateway reads no faster"
    )
    device_max_ahead_s: float = Field(
        60.0, ge=0, description="how far the time of a message may be ahead of the gateway's clock"
    )
    device_max_age_h: float = Field(
        48.0, gt=0, description="how old a message may be, for devices that buffer while they are away"
    )
    device_edge_max_age_h: float = Field(
        168.0, gt=0, description="how old a message may be that an edge has buffered"
    )
    device_task_timeout_s: float = Field(
        600.0, gt=0, description="deadline of a Task's command if the Task has no timeoutS"
    )
    device_report_interval_s: float = Field(
        1.0, gt=0, description="the values of a device are written to the broker at most this often"
    )
    device_reports_per_s: float = Field(
        100.0, gt=0, description="maximum Devices written to the broker a second, of all devices"
    )
    device_keep_messages_h: float = Field(
        720.0, gt=0, description="commands, states, events and errors of devices are kept for so many hours"
    )
    device_keep_telemetry_h: float = Field(
        24.0, gt=0, description="telemetry messages, whose values are kept apart, are kept for so many hours"
    )
    device_keep_values_h: float = Field(
        168.0, gt=0, description="values are kept at full rate for so many hours, then a mean for each minute"
    )
    device_keep_minutes_h: float = Field(
        2160.0, gt=0, description="minutes are kept for so many hours, then hours"
    )
    device_keep_hours_h: float = Field(
        26280.0, gt=0, description="hours of values are kept for so many hours, then deleted"
    )

    edge_upstream: str | None = Field(
        None,
        pattern=r"^(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+)(:[0-9]{1,5})?$",
        description="host:port of the device port of the central gateway; with it this gateway is an edge, "
        "which relays its devices over one TLS connection",
    )
    edge_name: str | None = Field(
        None, description="the name of this edge at the centre, a device of kind edge"
    )
    edge_token: SecretStr | None = Field(None, description="the token of this edge at the centre")
    edge_certificate: MaybePath = Field(
        None, description="PEM file of the certificate of this edge, instead of its token"
    )
    edge_key: MaybePath = Field(None, description="PEM file of the private key of that certificate")
    edge_buffer_mib: int = Field(
        1024,
        ge=1,
        description="size of the messages that wait at this edge for the centre; when it is reached, the "
        "oldest are dropped and counted",
    )
    edge_max_motion_delay_s: float = Field(
        2.0, gt=0, description="a motion command that took longer from the centre to this edge is refused"
    )
    edge_cancel_motions_after_s: float = Field(
        5.0,
        gt=0,
        description="when the centre is unreachable for so long, this edge cancels the motions that run",
    )

    @property
    def has_device_tls(self) -> bool:
        """Whether devices connect by TLS."""
        return bool(self.device_tls_certificate or (self.tls_certificate and not self.device_plain))

    @property
    def own_authority(self) -> Path:
        """The folder of the authority that makes certificates of devices, which may not exist."""
        return self.authority_dir or self.data_dir / "tls"

    @property
    def client_authority(self) -> Path | None:
        """The file of authorities of device certificates; None if there is none."""
        if self.device_client_authority is not None:
            return self.device_client_authority
        own = self.own_authority / AUTHORITY
        return own if own.is_file() else None

    @property
    def replica_host(self) -> str:
        """Where other replicas reach this one."""
        if self.gateway_replica_host is not None:
            return self.gateway_replica_host
        is_any = self.device_host in {"0.0.0.0", "::"}  # noqa: S104 - not bound
        return socket.gethostname() if is_any else self.device_host


SERVICE = Service(
    DEVICE_GATEWAY,
    "handover_devices",
    GatewaySettings,
    "gateway_port",
    also_listens=(("device_host", "device_port"),),
)
