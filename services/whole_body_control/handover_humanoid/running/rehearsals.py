"""The rehearsals of the hands of a humanoid: read from files, else made in a process of their own.

A rehearsal takes some seconds of CPU time, and ten times as long on a busy machine. So nothing waits for it
but the first throw of its hand. It is not made in a thread, since the wish would get old meanwhile.
"""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from handover.runtime.offload import Offload
from handover.telemetry import get_logger
from handover_humanoid.behaviours.rehearsal import (
    Throws,
    read_rehearsals,
    rehearsed,
    write_rehearsals,
)
from handover_humanoid.behaviours.throwing import Practice
from handover_humanoid.model.humanoid import Humanoid

log = get_logger(__name__)

TIMEOUT_S: Final = 600.0


class Rehearsals:
    """Teaches `practice` what the hands learn. Not thread-safe; each hand has a process of its own.

    `files` are read, those that come first count more; the last one is written.
    """

    def __init__(self, humanoid: Humanoid, practice: Practice, files: Sequence[Path]) -> None:
        self._humanoid, self._practice, self._files = humanoid, practice, files
        self._known: dict[str, Throws] = {}
        self._making: dict[str, asyncio.Task[None]] = {}
        self._offload = Offload(max_processes=len(humanoid.grips) or 1, timeout_s=TIMEOUT_S)
        self._writing = asyncio.Lock()

    def open(self) -> None:
        """Read the files; blocks for the disk."""
        for path in reversed(self._files):
            self._known |= read_rehearsals(path, self._humanoid)
        for grip, throws in self._known.items():
            self._practice.restore(grip, throws)

    def is_known(self, grip: str) -> bool:
        """Return whether a hand has rehearsed; also one whose rehearsal has failed."""
        return grip in self._known

    def begin(self) -> None:
        """Begin the rehearsal of every hand that has not rehearsed."""
        for grip in self._humanoid.grips:
            if not self.is_known(grip) and grip not in self._making:
                self._making[grip] = asyncio.create_task(self._make(grip))

    async def wait(self, grip: str) -> None:
        """Return when a hand has rehearsed."""
        self.begin()
        if not self.is_known(grip):
            await asyncio.shield(self._making[grip])

    async def close(self) -> None:
        """End the rehearsals."""
        for task in self._making.values():
            task.cancel()
        await asyncio.gather(*self._making.values(), return_exceptions=True)

    async def _make(self, grip: str) -> None:
        """Rehearse; a hand that cannot do it throws as planned, and learns from its throws only."""
        throws: Throws = ()
        try:
            throws = await self._offload.run(rehearsed, self._humanoid, grip)
        except Exception as error:  # noqa: BLE001 - a simulation may fail in any way, and is no reason not to throw
            log.warning("rehearsal failed", hand=grip, reason=repr(error))
        self._known[grip] = throws
        self._practice.restore(grip, throws)
        log.info("hand rehearsed", hand=grip, throws=len(throws))
        if throws:
            await self._keep()

    async def _keep(self) -> None:
        async with self._writing:
            try:
                learned = {grip: throws for grip, throws in self._known.items() if throws}
                await asyncio.to_thread(write_rehearsals, self._files[-1], self._humanoid, learned)
            except OSError as error:
                log.warning("rehearsal not stored", file=str(self._files[-1]), reason=str(error))
