"""Listening: one thread that takes what comes from DDS and hands it on.

The binding's listeners are called by Cyclone's own threads, which then wait for Python's lock while they hold
Cyclone's (and may wait for each other for good). A thread that waits on a bell and takes has no such trouble.
"""

import threading
from collections.abc import Callable
from typing import Any

import structlog

from ros_fiware_bridge.graph.cyclone.samples import Bell, Sample, Taker

log = structlog.get_logger(__name__)

_ROUND_NS = 1_000_000_000
OnSamples = Callable[[list[Sample]], None]


class Listening:
    """The thread, and the readers it takes from. What it calls runs in that thread, and must not wait."""

    def __init__(self, participant: Any) -> None:
        self._bell = Bell(participant)
        self._taker = Taker()
        self._lock = threading.RLock()
        self._attached: dict[int, tuple[Any, Callable[[], None]]] = {}
        self._next = Bell.STOP + 1
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="ros-graph", daemon=True)
        self._thread.start()

    def to_samples(self, reader: Any, on_samples: OnSamples) -> Callable[[], None]:
        """Take from `reader`; the function that is returned stops it (nothing is called after that)."""

        def take() -> None:
            while samples := self._taker.take(reader):
                on_samples(samples)

        return self.to(reader, take)

    def to(self, reader: Any, take: Callable[[], None]) -> Callable[[], None]:
        """Call `take` when `reader` has something; it must take all of it."""
        from cyclonedds.core import (  # noqa: PLC0415 - heavy
            InstanceState,
            ReadCondition,
            SampleState,
            ViewState,
        )

        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        with self._lock:
            number, self._next = self._next, self._next + 1
            self._attached[number] = (condition, take)
        self._bell.attach(condition, number)

        def stop() -> None:
            with self._lock:
                if self._attached.pop(number, None) is not None:
                    self._bell.detach(condition)
                    condition.__del__()

        return stop

    def _run(self) -> None:
        while not self._stopping:
            for number in sorted(self._bell.wait(_ROUND_NS)):
                with self._lock:
                    _, take = self._attached.get(number, (None, None))
                    if take is None:
                        continue
                    try:
                        take()
                    except Exception:  # one reader's fault must not silence the others
                        log.exception("what came from the ROS graph could not be taken")

    def stop(self) -> None:
        """End the thread and wait for it."""
        self._stopping = True
        self._bell.stop()
        self._thread.join(5.0)
        self._bell.close()
