"""What the sensors of persons who consent send, live for the Foxglove app of an engineer on this machine.

Off unless `HANDOVER_HEALTH_FOXGLOVE_PORT` is set. The server has no access control of its own, so it listens
on loopback only: everybody with an account on this machine can see the signals, by pseudonym.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Final

from handover.errors import UsageError
from handover.telemetry import get_logger
from services.human_state.exchange.foxglove import FoxgloveServer
from services.human_state.formats.errors import ExchangeError
from services.human_state.formats.json_messages import Recorded
from services.human_state.monitoring.monitoring import Monitoring
from services.human_state.monitoring.person_monitor import PersonMonitor

log = get_logger(__name__)

CHECK_EVERY_S: Final = 0.25


class FoxgloveFeed:
    """Taps the monitors of all persons. A monitor takes nothing without consent, so nothing is sent then."""

    def __init__(self, monitoring: Monitoring, port: int) -> None:
        self._monitoring = monitoring
        self._tapped: dict[PersonMonitor, Callable[[Recorded], None]] = {}
        self._has_failed = False
        self._is_closed = False
        try:
            self._server = FoxgloveServer(port=port)
        except ExchangeError as error:
            raise UsageError(f"{error}; change HANDOVER_HEALTH_FOXGLOVE_PORT, or leave it out") from None
        log.info("foxglove listens", port=self.port)

    @property
    def port(self) -> int:
        """Return the port on which it listens."""
        return self._server.port

    async def run(self) -> None:
        """Send until cancelled or closed."""
        while not self._is_closed:
            self._follow()
            await asyncio.sleep(CHECK_EVERY_S)

    def close(self) -> None:
        """Close all connections; nothing is sent any more."""
        self._is_closed = True
        for monitor, tap in self._tapped.items():
            monitor.taps.discard(tap)
        self._tapped.clear()
        self._server.close()

    def _follow(self) -> None:
        """Tap new monitors; those of persons who withdrew their consent are gone."""
        present = set(self._monitoring.monitors.values())
        self._tapped = {monitor: tap for monitor, tap in self._tapped.items() if monitor in present}
        for monitor in present - self._tapped.keys():
            tap = partial(self._send, monitor.person.pseudonym)
            self._tapped[monitor] = tap
            monitor.taps.add(tap)

    def _send(self, subject: str, item: Recorded) -> None:
        try:
            self._server.publish(item, subject)
        except ExchangeError as error:
            if not self._has_failed:
                log.warning("foxglove does not get all signals", error=str(error))
            self._has_failed = True
