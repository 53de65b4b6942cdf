"""The settings of the web UI server: its own port, and the addresses of the services."""

import ipaddress
from urllib.parse import urlsplit

from pydantic import Field

from handover.extensions import Service
from handover.service_addresses import GESTURE_CONTROLLER, WEBUI, CellAddresses
from handover.settings import Names, Settings


class WebuiSettings(CellAddresses, Settings):
    """The settings of the web UI server."""

    cell_tenants: Names = Field(
        (), description="tenants of the broker whose cells the page lists besides those of its own"
    )
    emergency_stop: str | None = Field(
        None,
        max_length=120,
        description="the location of the emergency stop, as shown on the Work page; the red button on the "
        "cell if absent",
    )

    @property
    def glove_server_host(self) -> str:
        """The host to which a glove on this machine connects.

        If the controller listens for gloves on all its addresses or on loopback, this is the host of its URL.
        """
        behind_url = urlsplit(self.service_urls[GESTURE_CONTROLLER]).hostname or self.glove_host
        try:
            address = ipaddress.ip_address(self.glove_host)
        except ValueError:
            return behind_url if self.glove_host == "localhost" else self.glove_host
        return behind_url if address.is_unspecified or address.is_loopback else self.glove_host


SERVICE = Service(WEBUI, "handover_web", WebuiSettings, "webui_port")
