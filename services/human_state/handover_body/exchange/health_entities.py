"""Writes entities about the body of a person: to our broker, which has rights for them.

To another one they are written where the setting `HANDOVER_HEALTH_ON_OTHER_BROKER` allows it.
"""

from collections.abc import Mapping
from typing import Any, Final

from handover.broker import BrokerClient
from handover.telemetry import get_logger
from handover_body.exchange.ngsi_ld import only_fused
from handover_body.settings import HumanStateSettings

log = get_logger(__name__)

_WRITTEN: Final = "the broker is not ours: everybody who reads it reads the body signals of persons"
_NOT_WRITTEN: Final = (
    "body signals are not written to a broker that is not ours and has no rights of ours; "
    "an owner allows it with HANDOVER_HEALTH_ON_OTHER_BROKER=true"
)


class HealthEntities:
    """The entities of this service that only those with `readHealthData` may see."""

    def __init__(self, settings: HumanStateSettings, broker: BrokerClient) -> None:
        self._is_allowed_elsewhere = settings.health_on_other_broker
        self.broker = broker
        self._is_said = False

    async def upsert(self, entity: Mapping[str, Any]) -> None:
        """Create or update an entity; nothing is written to another broker that may not have it.

        Another broker may not keep several instances of an attribute, and gets the fused values alone. Raises
        `BrokerError`.
        """
        identity = await self.broker.identity()
        if not identity.is_ours and not self._is_said:
            self._is_said = True
            log.warning(_WRITTEN if self._is_allowed_elsewhere else _NOT_WRITTEN, broker=self.broker.url)
        if identity.is_ours or self._is_allowed_elsewhere:
            await self.broker.upsert([entity if identity.keeps_instances else only_fused(entity)])
