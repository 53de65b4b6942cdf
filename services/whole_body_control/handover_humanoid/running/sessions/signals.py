"""Signals to the patient, such as the haptic pulse of a catch.

A receiver that does not read loses the oldest.
"""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

MAX_WAITING: Final = 8

Waiting = asyncio.Queue[dict[str, Any]]


class PatientSignals:
    """Sends each signal to all receivers."""

    def __init__(self) -> None:
        self._receivers: set[Waiting] = set()

    @contextmanager
    def receiver(self) -> Iterator[Waiting]:
        """Receive signals within the context."""
        waiting: Waiting = asyncio.Queue(MAX_WAITING)
        self._receivers.add(waiting)
        try:
            yield waiting
        finally:
            self._receivers.discard(waiting)

    def send(self, signal: dict[str, Any]) -> None:
        """Send a signal."""
        for waiting in self._receivers:
            if waiting.full():
                waiting.get_nowait()
            waiting.put_nowait(signal)
