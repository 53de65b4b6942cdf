"""The settings of assistive devices, in addition to the common ones."""

from pydantic import Field, SecretStr

from handover.ros_dds import MAX_DOMAIN
from handover.settings import Names, Settings


class AssistiveSettings(Settings):
    """The machines that run, and where the state of persons comes from."""

    assistive_port: int = Field(54290, ge=1, le=65535, description="REST port of assistive devices")
    assistive_url: str | None = Field(
        None, description="where others reach assistive devices; http://host:port of it if absent"
    )
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
    human_state_port: int = Field(54250, ge=1, le=65535, description="REST and WebSocket port of human state")
    human_state_url: str | None = Field(
        None, description="where others reach human state; http://host:port of it if absent"
    )
    trajectory_port: int = Field(54220, ge=1, le=65535, description="REST and WebSocket port of the tool")
    trajectory_url: str | None = Field(
        None, description="where speed limits reach the trajectory tool; http://host:port of it if absent"
    )

    @property
    def human_state(self) -> str:
        """The URL of human state."""
        return self.url_of(self.human_state_port, self.human_state_url)

    @property
    def trajectory_tool(self) -> str:
        """The URL of the trajectory tool."""
        return self.url_of(self.trajectory_port, self.trajectory_url)
