"""Orchestrator: the components that run processes, wired to each other."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Self, TypeVar

from handover.broker import BrokerClient
from handover.database import connect
from handover.telemetry import get_logger
from handover_processes.operations.archiving import Archiving
from handover_processes.operations.broker_changes import BrokerChanges
from handover_processes.operations.definition_holds import DefinitionHolds
from handover_processes.operations.deployments import Deployments
from handover_processes.operations.device_leases import DeviceLeases
from handover_processes.operations.due_timers import DueTimers
from handover_processes.operations.lost_performers import LostPerformers
from handover_processes.operations.offering import Offering
from handover_processes.operations.process_control import ProcessControl
from handover_processes.operations.tasklist import Tasklist
from handover_processes.records.messages import Message
from handover_processes.settings import OrchestratorSettings
from handover_processes.steps.cell_presence import CellPresence
from handover_processes.steps.outbox import Outbox
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import Clock, WorkingState, utc_now
from handover_processes.storage.store import Store

log = get_logger(__name__)

READERS = 2
"""Threads that read for people while another one writes steps."""

T = TypeVar("T")


class Orchestrator:
    """All processes of this factory; an asynchronous context manager while it changes."""

    def __init__(
        self, settings: OrchestratorSettings, broker: BrokerClient, *, clock: Clock = utc_now
    ) -> None:
        self.settings = settings
        self.clock = clock
        self.store = Store(connect(settings.database("orchestrator")))
        self._disk = ThreadPoolExecutor(1, "orchestrator-disk")
        self._readers = ThreadPoolExecutor(READERS, "orchestrator-reader")
        self.state = WorkingState(settings, self.store, self.on_disk, clock)
        self.cell = CellPresence(self.state, broker, self.on_disk)
        self.outbox = Outbox(settings, broker, self._on_rejected, may_deliver=self.cell.wait)
        self.writer = StepWriter(self.state, self.outbox)
        self.deployments = Deployments(self.state, self.writer)
        self.holds = DefinitionHolds(self.state, self.writer)
        self.processes = ProcessControl(self.state, self.writer)
        self.leases = DeviceLeases(self.store, self.on_disk, self.cell.refuse_if_in_use)
        self.broker_changes = BrokerChanges(self.state, self.writer, self.leases)
        self.tasklist = Tasklist(self.state, self.writer, self.broker_changes, broker)
        self.timers = DueTimers(self.state, self.writer)
        self.archiving = Archiving(self.state, self.writer)
        self.offering = Offering(self.state, self.writer)
        self.lost_performers = LostPerformers(self.state, self.writer, self.leases)

    async def __aenter__(self) -> Self:
        await self.state.load()
        await self.leases.open()
        await self.cell.__aenter__()
        await self.writer.__aenter__()
        await self.lost_performers.__aenter__()
        log.info("orchestrator started", processes=len(self.state.active_processes.processes))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.lost_performers.__aexit__()
        await self.writer.__aexit__()
        await self.cell.__aexit__()
        self._readers.shutdown()
        await self.on_disk(self.store.close)
        self._disk.shutdown()

    async def on_disk(self, action: Callable[..., T], *arguments: Any) -> T:
        """Run a blocking `action` of the store in its thread."""
        return await asyncio.get_running_loop().run_in_executor(self._disk, action, *arguments)

    async def read(self, action: Callable[..., T], *arguments: Any, **named: Any) -> T:
        """Run a blocking `action` that only reads, beside the steps that are written."""
        return await asyncio.get_running_loop().run_in_executor(
            self._readers, partial(action, *arguments, **named)
        )

    async def _on_rejected(self, message: Message, reason: str) -> None:
        await self.broker_changes.reject(message, reason)
