"""The observers of a glove: screens, recorders, calibrations and accuracy tests."""

import asyncio
from collections.abc import Callable
from typing import Any

Watcher = Callable[[bool], None]
"""Called on every change, at most once a frame; must return quickly.

The argument is False if only the hand moved, True if screens should show the change at once.
"""

View = Callable[[], dict[str, Any]]


class GloveObservers:
    """The observers of one glove."""

    def __init__(self) -> None:
        self.watchers: set[Watcher] = set()
        self.recorders: set[Callable[[bytes], None]] = set()
        """Called with the raw line of every frame."""
        self.accuracy_test: View | None = None
        """Returns what the screen shows of the current accuracy test."""
        self.calibration: View | None = None
        """Returns what the screen shows of the current or last calibration."""
        self.forgotten = asyncio.Event()
        """Set when the controller has forgotten the glove; screens then stop following it."""

    def notify(self, *, is_urgent: bool) -> None:
        """Call the watchers."""
        for watcher in self.watchers:
            watcher(is_urgent)

    def record(self, line: bytes) -> None:
        """Call the recorders."""
        for record in self.recorders:
            record(line)
