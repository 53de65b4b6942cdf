"""The settings of the alert router, in addition to the common ones."""

from typing import ClassVar

from pydantic import Field, SecretStr

from handover.extensions import Service
from handover.service_addresses import ALERT_ROUTER, AlertRouterAddress
from handover.settings import MaybePath, Settings


class RouterSettings(AlertRouterAddress, Settings):
    """The address of the service, the mail server and the file of channels and routes."""

    removed: ClassVar = {
        "send_timeout_s": "a server that takes longer than 30 s to accept a message is tried again later"
    }

    alert_routes: MaybePath = Field(
        None, description="YAML file of channels and routes for Alerts; both can be added by REST as well"
    )
    alert_retention_days: float = Field(
        365.0, gt=0, description="the log of what was sent is kept for so many days"
    )
    smtp_url: str | None = Field(
        None,
        description="the mail server, smtps://user@host:465 or smtp://user@host:587 (with STARTTLS)",
    )
    smtp_password: SecretStr | None = Field(None, description="the password of that user")
    smtp_sender: str = Field("handover@localhost", description="the sender of mails")
    smtp_plain: bool = Field(
        False, description="send mails without TLS to a server beyond this machine, in a trusted network"
    )


SERVICE = Service(ALERT_ROUTER, "handover_alerts", RouterSettings, "alert_router_port")
