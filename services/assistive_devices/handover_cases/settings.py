"""The settings of assistive devices, in addition to the common ones."""

from pydantic import Field, SecretStr

from handover.extensions import Service
from handover.formats.ros_dds import MAX_DOMAIN
from handover.service_addresses import (
    ASSISTIVE_DEVICES,
    AssistiveAddress,
    HumanStateAddress,
    TrajectoryAddress,
)
from handover.settings import Names, Settings


class AssistiveSettings(AssistiveAddress, HumanStateAddress, TrajectoryAddress, Settings):
    """The machines that run, and where the state of persons comes from."""

    assistive_machines: Names = Field(
        (), description="the machines that run, separated by commas: wheelchair, bed, treadmill, bin-picking"
    )
    assistive_ros_domain: int | None = Field(
        None,
        ge=0,
        le=MAX_DOMAIN,
        description="the ROS domain in which the machines publish their commands at the rate of their "
        "controllers; absent: nowhere",
    )
    trainer_model_url: str | None = Field(
        None,
        description="an OpenAI-compatible server that words the advice of the treadmill trainer for people "
        "who consent, such as https://host/v1; absent: templates word it, and nothing leaves",
    )
    trainer_model_name: str = Field("", max_length=200, description="the name of the model on that server")
    trainer_model_key: SecretStr | None = Field(None, description="the key for that server")
    trainer_model_timeout_s: float = Field(
        4.0, gt=0, le=20, description="after so many seconds a template words the advice instead of the model"
    )
    trainer_log_days: float = Field(
        30.0, gt=0, description="trainings and what the trainer said are deleted after so many days"
    )


SERVICE = Service(
    ASSISTIVE_DEVICES,
    "handover_cases",
    AssistiveSettings,
    "assistive_port",
    runs_if=lambda: bool(AssistiveSettings.load().assistive_machines),
)
