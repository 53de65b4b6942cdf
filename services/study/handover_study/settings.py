"""The settings of the study service, in addition to the common ones."""

from pydantic import Field

from handover.settings import Settings


class StudySettings(Settings):
    """The address of the service, and that of the gesture controller."""

    study_port: int = Field(54270, ge=1, le=65535, description="REST port of the study service")
    study_url: str | None = Field(
        None, description="the URL of the study service for others; by default http://host:port"
    )
    controller_port: int = Field(
        54210, ge=1, le=65535, description="REST and WebSocket port of the controller"
    )
    controller_url: str | None = Field(
        None, description="the URL of the controller; http://host:port of it if absent"
    )

    @property
    def gesture_controller(self) -> str:
        """The URL of the gesture controller."""
        return self.url_of(self.controller_port, self.controller_url)
