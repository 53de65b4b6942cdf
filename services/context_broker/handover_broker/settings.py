"""The settings of the embedded broker."""

import socket
from contextlib import suppress
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from pydantic import Field, FilePath, ValidationInfo, field_validator

from handover.extensions import Service
from handover.network.outbound_policy import is_loopback
from handover.service_addresses import BROKER
from handover.settings import Names, Settings
from handover_datamodels.contexts import HANDOVER_URL

DATABASE = "broker.db"
"""The SQLite file in the data directory."""


class BrokerSettings(Settings):
    """Settings of the embedded broker."""

    broker_database_url: str | None = Field(
        None,
        pattern="^(postgres(ql)?://.*)?$",
        description="postgresql:// URL of the broker's database, on which a second broker is a standby; "
        "a SQLite file in the data directory if absent",
    )
    broker_http: Literal["direct", "asgi"] = Field(
        "direct",
        description="how requests reach the broker: from the HTTP parser directly, or over ASGI, which "
        "takes a third more time and depends less on parts of uvicorn that may change",
    )
    broker_max_body_bytes: int = Field(
        10 * 1024 * 1024, ge=1024, description="the largest request body that the broker reads"
    )
    broker_notification_timeout_s: float = Field(
        5.0, gt=0, description="how long the broker waits for a subscriber to answer a notification"
    )
    broker_notification_keep_h: float = Field(
        24.0, gt=0, description="how long a notification that cannot be delivered is retried, in hours"
    )
    broker_notification_keep_mb: int = Field(
        1024,
        ge=1,
        description="how much may be pending on disk for one endpoint; beyond it the oldest are dropped",
    )
    broker_notification_ca_file: FilePath | None = Field(
        None, description="certificate authorities (PEM) for subscribers, besides those of the system"
    )
    broker_source_timeout_s: float = Field(
        5.0,
        gt=0,
        description="how long the broker waits for a context source whose registration does not say",
    )
    broker_context_timeout_s: float = Field(
        5.0, gt=0, description="how long the broker waits for an @context that it must fetch"
    )

    broker_default_context: str | None = Field(
        None,
        description="the URL of the @context of requests that give none, in a Link header or in the body; "
        "handover for that of Handover, which is built in; if absent, the core @context alone",
    )
    broker_public_url: str | None = Field(
        None,
        description="where others reach the broker, without /ngsi-ld/v1: the @contexts that it hosts have "
        "their URLs there, and context sources notify it there; if absent, where it was called",
    )

    @property
    def ca_files(self) -> tuple[Path, ...]:
        """The files with authorities that the broker trusts where it is a client."""
        return tuple(file for file in (self.tls_authority, self.broker_notification_ca_file) if file)

    @field_validator("broker_public_url", "broker_default_context")
    @classmethod
    def _is_address(cls, url: str | None, info: ValidationInfo) -> str | None:
        if url == "handover" and info.field_name == "broker_default_context":
            return HANDOVER_URL
        if url and not url.startswith(("http://", "https://")):
            raise ValueError("must start with http:// or https://")
        return url or None

    @field_validator("broker_public_url")
    @classmethod
    def _is_root(cls, url: str | None) -> str | None:
        return None if url is None else url.rstrip("/").removesuffix("/ngsi-ld/v1")

    broker_federation: bool | None = Field(
        None,
        description="whether the broker has context source registrations and entity maps, and distributes "
        "operations; if absent, where the plugin is installed",
    )
    broker_snapshots: bool | None = Field(
        None, description="whether the broker has snapshots; if absent, where the plugin is installed"
    )
    broker_health_types: Names = Field(
        ("HumanState", "PhysiologicalSession", "PressureMat"),
        description="types of entities about the body of a person, comma-separated; with accounts they are "
        "visible with the permission readHealthData only",
    )
    broker_history: bool = Field(
        default=True, description="whether the broker records changes for the temporal API"
    )
    broker_history_keep_days: float = Field(
        7.0,
        ge=0,
        description="for how many days the broker keeps history, about a GB a day if 30 "
        "attributes change each second; 0 keeps it for ever",
    )


def has_own_broker() -> bool:
    """Return whether the broker of the settings is the embedded one: at its port of this machine."""
    settings = Settings.load()
    url = urlsplit(settings.broker_url)
    port = url.port or (443 if url.scheme == "https" else 80)
    return port == settings.broker_port and _is_here(url.hostname or "")


def _is_here(host: str) -> bool:
    """Return whether a host is this machine: an address is its own if a socket can be bound to it."""
    if is_loopback(host):
        return True
    try:
        places = socket.getaddrinfo(host, 0, type=socket.SOCK_DGRAM)
    except OSError:
        return False
    for family, kind, _, _, address in places:
        with socket.socket(family, kind) as probe, suppress(OSError):
            probe.bind(address)
            return True
    return False


SERVICE = Service(BROKER, "handover_broker", BrokerSettings, "broker_port", runs_if=has_own_broker)
