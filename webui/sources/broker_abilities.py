"""What another broker can do, as the page *System* and the metrics of this server say it."""

from handover.broker import BrokerClient
from handover.broker_abilities import FoundAbilities, find_abilities
from handover.settings import Settings
from webui.metrics import BROKER_ABILITIES


class BrokerAbilities:
    """The abilities of the broker, which are found once for each broker."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._settings = settings
        self._broker = broker
        self._found: FoundAbilities | None = None

    async def is_of_ours(self) -> bool:
        """Return whether it is the embedded broker. Raises `BrokerError`."""
        return (await self._broker.identity()).is_ours

    async def check(self) -> str:
        """Read from the broker; return one line about what it can do. Raises `BrokerError`."""
        await self._broker.probe()
        if self._found is None or self._found.identity != await self._broker.identity():
            self._found = await find_abilities(self._broker, self._settings)
            for name, is_there in self._found.are_there.items():
                BROKER_ABILITIES.labels(name).set(is_there)
        return self._found.summary()
