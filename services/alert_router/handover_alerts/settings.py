"""The settings of the alert router, in addition to the common ones."""

from pydantic import Field, SecretStr

from handover.settings import MaybePath, Settings


class RouterSettings(Settings):
    """The address of the service, the mail server and the file of channels and routes."""

    alert_router_port: int = Field(54280, ge=1, le=65535, description="REST port of the alert router")
    alert_router_url: str | None = Field(
        None, description="where the broker reaches the alert router; http://host:port of it if absent"
    )
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
    send_timeout_s: float = Field(
        30.0, gt=0, description="a server that takes longer to accept a message is tried again later"
    )

    @property
    def service_url(self) -> str:
        """The URL of the alert router."""
        return self.url_of(self.alert_router_port, self.alert_router_url)
