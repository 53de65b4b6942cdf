"""What another broker can do, as the page *Services* and the metrics of this server say it."""

from typing import Final, Literal

from handover.broker import BrokerClient
from handover.broker.abilities import FoundAbilities, find_abilities
from handover.settings import Settings
from handover_web.metrics import BROKER_ABILITIES

MAX_CLOCK_DIFFERENCE_S: Final = 60.0


class BrokerAbilities:
    """The abilities of the broker, which are found once for each broker."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._settings = settings
        self._broker = broker
        self._found: FoundAbilities | None = None

    async def is_of_ours(self) -> bool:
        """Return whether it is the embedded broker. Raises `BrokerError`."""
        return (await self._broker.identity()).is_ours

    async def check(self) -> tuple[Literal["up", "degraded"], str]:
        """Read from the broker; return its state, and one line about what it can do. Raises `BrokerError`."""
        ahead_s = await self._broker.probe()
        if self._found is None or self._found.identity != await self._broker.identity():
            self._found = await find_abilities(self._broker, self._settings)
            for name, is_there in self._found.are_there.items():
                BROKER_ABILITIES.labels(name).set(is_there)
        summary = self._found.summary()
        if ahead_s is None or abs(ahead_s) <= MAX_CLOCK_DIFFERENCE_S:
            return "up", summary
        return "degraded", (
            f"its clock is {abs(ahead_s):.0f} s {'ahead of' if ahead_s > 0 else 'behind'} ours, so "
            f"events may be missed and ends of Tasks misjudged; set both clocks by NTP. {summary}"
        )
