"""What a list shows: the devices that the grants of the caller include."""

from typing import Annotated

from handover.security.caller import Caller
from handover.security.guard import require_somewhere
from handover.security.permissions import Permission
from handover_devices.registry.entities import device_id
from handover_devices.settings import GatewaySettings

Reader = Annotated[Caller, require_somewhere(Permission.READ)]


def may_read(caller: Caller, settings: GatewaySettings, name: str) -> bool:
    """Return whether the caller may read a device."""
    return caller.may(Permission.READ, device_id(settings, name))
