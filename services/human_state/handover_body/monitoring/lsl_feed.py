"""What the sensors of named persons send, live as streams of the Lab Streaming Layer.

Off unless `HANDOVER_HEALTH_LSL_PEOPLE` names persons: streams are not encrypted, and everybody in the local
network can receive them, by pseudonym.
"""

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Final

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_body.exchange.lsl import LslOutlets
from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import Recorded
from handover_body.model.features import Feature
from handover_body.model.signals import Samples
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor

log = get_logger(__name__)

CHECK_EVERY_S: Final = 0.25


class LslFeed:
    """Taps the monitors of `people`. A monitor takes nothing without consent, so nothing is sent then.

    `signals` are kinds of signals and names of features; empty: all.
    """

    def __init__(self, monitoring: Monitoring, people: tuple[str, ...], signals: tuple[str, ...]) -> None:
        self._monitoring = monitoring
        self._people = frozenset(people)
        self._signals = frozenset(signals)
        self._tapped: dict[PersonMonitor, tuple[LslOutlets, Callable[[Recorded], None]]] = {}
        self._has_failed = False
        self._is_closed = False
        try:
            LslOutlets("").close()
        except ExchangeError as error:
            raise UsageError(f"{error}; or leave HANDOVER_HEALTH_LSL_PEOPLE out") from None
        log.info("streams of LSL are visible in the local network", people=len(self._people))

    async def run(self) -> None:
        """Send until cancelled or closed."""
        while not self._is_closed:
            self._follow()
            await asyncio.sleep(CHECK_EVERY_S)

    def close(self) -> None:
        """Close all streams."""
        self._is_closed = True
        for monitor in list(self._tapped):
            self._leave(monitor)

    def _follow(self) -> None:
        """Tap new monitors; close the streams of persons who withdrew their consent."""
        present = {
            wanted for wanted in self._monitoring.monitors.values() if wanted.person.name in self._people
        }
        for monitor in self._tapped.keys() - present:
            self._leave(monitor)
        for monitor in present - self._tapped.keys():
            outlets = LslOutlets(monitor.person.pseudonym)
            tap = partial(self._send, outlets)
            self._tapped[monitor] = (outlets, tap)
            monitor.taps.add(tap)

    def _leave(self, monitor: PersonMonitor) -> None:
        outlets, tap = self._tapped.pop(monitor)
        monitor.taps.discard(tap)
        outlets.close()

    def _send(self, outlets: LslOutlets, item: Recorded) -> None:
        if not isinstance(item, Samples | Feature):
            return
        name = item.info.kind.value if isinstance(item, Samples) else item.name.value
        if self._signals and name not in self._signals:
            return
        try:
            outlets.push(item)
        except ExchangeError as error:
            if not self._has_failed:
                log.warning("LSL does not get all signals", error=str(error))
            self._has_failed = True
