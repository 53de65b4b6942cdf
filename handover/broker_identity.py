"""Which broker answers: the embedded one, or another one by the version that it says.

What brokers do differently is decided by this, and never tried on entities of people: some keep damage.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from handover.broker import BrokerClient

SOFTWARE: Final = "Handover"
"""What the embedded broker says in `contextSourceExtras` of its identity (ETSI GS CIM 009, clause 5.15)."""
_ORION_VERSION: Final = "/ngsi-ld/ex/v1/version"


@dataclass(frozen=True, slots=True)
class BrokerIdentity:
    """A broker by name and version, which are empty where it does not say them."""

    name: str = ""
    version: str = ""

    @property
    def keeps_instances(self) -> bool:
        """Whether a batch may have attributes with several instances (`datasetId`).

        Orion-LD 1.6 refuses or damages such an entity; of a broker that is not known it is not assumed.
        """
        return self.name == SOFTWARE


async def identify(broker: BrokerClient) -> BrokerIdentity:
    """Ask a broker who it is. Raises `BrokerUnavailable`."""
    orion = await broker.look_up(_ORION_VERSION)
    if isinstance(orion, Mapping):
        found = {str(key).lower().replace("-", ""): str(value) for key, value in orion.items()}
        return BrokerIdentity("Orion-LD", found.get("orionld version", ""))
    identity: Any = await broker.look_up("/ngsi-ld/v1/info/sourceIdentity")
    extras = identity.get("contextSourceExtras") if isinstance(identity, Mapping) else None
    if not isinstance(extras, Mapping):
        return BrokerIdentity()
    return BrokerIdentity(str(extras.get("software", "")), str(extras.get("version", "")))
