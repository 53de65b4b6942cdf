"""The end of a process of the control cycle by a signal: it ends itself, when its robot may be left."""

import signal
from typing import Any


class EndBySignal:
    """Whether SIGTERM or SIGINT asked the process to end; made in its main thread."""

    def __init__(self) -> None:
        self.is_wanted = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._end)

    def _end(self, *_: Any) -> None:
        self.is_wanted = True
