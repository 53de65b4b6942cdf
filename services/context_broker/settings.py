"""What an operator may set about the broker: its port, its limits and its patience with subscribers."""

from pydantic import Field

from handover.settings import Settings


class BrokerSettings(Settings):
    """Settings of the embedded broker."""

    broker_port: int = Field(1026, ge=1, le=65535, description="the port of the embedded broker")
    broker_max_body_bytes: int = Field(
        10 * 1024 * 1024, ge=1024, description="the largest request body that the broker reads"
    )
    broker_notification_timeout_s: float = Field(
        5.0, gt=0, description="how long the broker waits for a subscriber to answer a notification"
    )
    broker_notification_keep_h: float = Field(
        24.0, gt=0, description="how long a notification that cannot be delivered is tried again, in hours"
    )
    broker_context_timeout_s: float = Field(
        5.0, gt=0, description="how long the broker waits for an @context that it must fetch"
    )
