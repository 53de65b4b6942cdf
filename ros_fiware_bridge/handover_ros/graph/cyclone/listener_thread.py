"""One thread that takes samples from DDS readers and passes them on.

Cyclone's own threads call the listeners of the binding: they wait for the GIL while they hold locks of
Cyclone, which can deadlock. A thread that waits on a wait set and takes the samples itself avoids this.
"""

import threading
from collections.abc import Callable
from typing import Any

import structlog

from handover_ros.graph.cyclone.samples import ReaderWaitSet, Sample, SampleTaker

log = structlog.get_logger(__name__)

_WAIT_TIMEOUT_NS = 1_000_000_000
OnSamples = Callable[[list[Sample]], None]


class ListenerThread:
    """The thread and its readers. Callbacks run in that thread, and must not block."""

    def __init__(self, participant: Any) -> None:
        self._wait_set = ReaderWaitSet(participant)
        self._taker = SampleTaker()
        self._lock = threading.RLock()
        self._attached: dict[int, tuple[Any, Callable[[], None]]] = {}
        self._next = ReaderWaitSet.STOP + 1
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="ros-graph", daemon=True)
        self._thread.start()

    def to_samples(self, reader: Any, on_samples: OnSamples) -> Callable[[], None]:
        """Take samples from `reader`; the returned function stops it (no callback runs after that)."""

        def take() -> None:
            while samples := self._taker.take(reader):
                on_samples(samples)

        return self.to(reader, take)

    def to(self, reader: Any, take: Callable[[], None]) -> Callable[[], None]:
        """Call `take` when `reader` has samples; it must take all of them."""
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
        self._wait_set.attach(condition, number)

        def stop() -> None:
            with self._lock:
                if self._attached.pop(number, None) is not None:
                    self._wait_set.detach(condition)
                    condition.__del__()

        return stop

    def _run(self) -> None:
        while not self._stopping:
            for number in sorted(self._wait_set.wait(_WAIT_TIMEOUT_NS)):
                with self._lock:
                    _, take = self._attached.get(number, (None, None))
                    if take is None:
                        continue
                    try:
                        take()
                    except Exception:  # an error of one reader must not stop the others
                        log.exception("processing samples of the ROS graph failed")

    def stop(self) -> None:
        """Stop the thread and wait for its end."""
        self._stopping = True
        self._wait_set.stop()
        self._thread.join(5.0)
        self._wait_set.close()
