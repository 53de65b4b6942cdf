"""Who may see and move the humanoid: grants name its Device; sessions are data of their person."""

from typing import Final

from starlette.requests import HTTPConnection

from handover.security.guard import ResourceOf, guard_of
from handover_humanoid.settings import WholeBodySettings


def _of_humanoid(connection: HTTPConnection) -> str:
    settings = guard_of(connection).settings
    assert isinstance(settings, WholeBodySettings)  # noqa: S101 - the guard was made with them
    return settings.entity_id("Device", settings.humanoid_name)


_of_humanoid.__doc__ = "the Device of the humanoid"
of_humanoid: Final[ResourceOf] = _of_humanoid
