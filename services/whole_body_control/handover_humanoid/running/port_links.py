"""The ports of the control cycle as the service uses them: the wish written, the state read, in one task."""

import asyncio
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.running.cycle_process import CycleProcess

log = get_logger(__name__)

WRITE_EVERY_S: Final = 0.02
STATE_TIMEOUT_S: Final = 0.5
"""A state that is older is not shown as live: the cycle hangs, or has ended."""

Values = Mapping[str, float]


class PortLinks:
    """Writes the wish, what a person does and the gains, and reads the state, 50 times a second.

    What a person does is also written when it comes.

    `values` are the newest ones by name, empty without a cycle; `on_tick` is called after each reading.
    """

    def __init__(
        self,
        process: CycleProcess,
        wish: Callable[[tuple[str, ...]], list[float]],
        person: Callable[[tuple[str, ...]], list[float] | None],
        gains: Callable[[tuple[str, ...]], list[float]],
    ) -> None:
        self.values: Values = {}
        self.age_s = float("inf")
        self.on_tick: Callable[[], None] = lambda: None
        self.may_command: Callable[[], bool] = lambda: True
        """Whether this process has the lease of the humanoid; without it nothing is written."""
        self._process = process
        self._wish, self._person, self._gains = wish, person, gains
        self._writers: dict[str, PortWriter] = {}
        self._state: PortReader | None = None
        self._starts = -1

    @property
    def is_live(self) -> bool:
        """Whether the cycle runs and writes its state."""
        return not self._process.problem and self.age_s < STATE_TIMEOUT_S

    async def run(self) -> None:
        """Write and read until cancelled."""
        try:
            while True:
                self._tick()
                self.on_tick()
                await asyncio.sleep(WRITE_EVERY_S)
        finally:
            self._close()

    def refresh(self) -> None:
        """Read the state now: a headset asks more often than the wish is written."""
        if self._state is not None and not self._process.problem:
            self._read()

    def write_person(self) -> None:
        """Write what a person does, between two ticks."""
        if self._starts == self._process.starts and not self._process.problem:
            self._write("person", self._person)

    def _tick(self) -> None:
        if self._starts != self._process.starts:
            self._close()
            self._starts = self._process.starts
        if self._process.problem:
            self.values, self.age_s = {}, float("inf")
            return
        self._write("wish", self._wish)
        self._write("person", self._person)
        self._write("gains", self._gains)
        self._read()

    def _write(self, name: str, values_of: Callable[[tuple[str, ...]], list[float] | None]) -> None:
        writer = self._writers.get(name) or self._opened(name)
        if writer is None:
            return
        values = values_of(writer.names)
        if values is not None and self.may_command():
            writer.write(np.array(values))

    def _opened(self, name: str) -> PortWriter | None:
        """Return the writer of a port that the cycle has made, with the values that it expects."""
        path = self._process.folder / name
        reader = _reader(path)
        if reader is None:
            return None
        try:
            writer = PortWriter(path, reader.names)
        except UsageError as error:  # the cycle is just making it
            log.debug("port not opened", port=name, reason=str(error))
            return None
        self._writers[name] = writer
        return writer

    def _read(self) -> None:
        if self._state is None:
            self._state = _reader(self._process.folder / "state")
        state = self._state
        if state is None:
            return
        if state.read() and state.time_ns:  # before the first values there are none
            self.values = dict(zip(state.names, state.values.tolist(), strict=True))
        self.age_s = state.age_s(time.monotonic_ns())

    def _close(self) -> None:
        for writer in self._writers.values():
            writer.close()
        self._writers.clear()
        self._state, self.values, self.age_s = None, {}, float("inf")


def _reader(path: Path) -> PortReader | None:
    try:
        return PortReader(path) if path.exists() else None
    except UsageError:  # it is just being made
        return None
