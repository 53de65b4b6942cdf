"""Cell presence: describes the cell to the broker, and notices another cell with the same name.

Two cells with one name in one tenant would give each other's robots Tasks and replace each other's
subscriptions. So the name is claimed first: by writing the `Cell` with the identity of this orchestrator's
database. While another identity has it and writes it again and again, nothing is sent to the broker, and no
Device is leased, so that no performer of this cell acts on Tasks of the other; what was stored waits. No
clock of another machine is compared: a `Cell` that does not change for `WATCH_S` is of an orchestrator that
has ended.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from datetime import timedelta
from typing import Any, Final, Self

from sqlalchemy.exc import SQLAlchemyError

from handover.broker import AlreadyExists, BrokerClient, BrokerUnavailable, NotFound
from handover.database.outage import outage_problem
from handover.errors import Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff, with_jitter
from handover.telemetry import get_logger
from handover_datamodels.entities import Cell
from handover_datamodels.states import CellState
from handover_processes.steps.working_state import WorkingState
from handover_processes.storage.cell_identity import identity_of
from handover_processes.storage.counts import PeriodCount

log = get_logger(__name__)

HEARTBEAT_S: Final = 30.0
WATCH_S: Final = 2.5 * HEARTBEAT_S
SETTLE_S: Final = 1.0
"""After this time it is looked whether another orchestrator has created or replaced the cell, too."""
GOODBYE_S: Final = 2.0
"""How long the end waits for a broker that may have ended before."""

ASKED_WITHIN_S: Final = 1.0

OnDisk = Callable[..., Awaitable[Any]]


class CellNameInUse(BrokerUnavailable):
    """Another cell on the broker has the same name; a retry succeeds once it has ended."""


class CellPresence:
    """The `Cell` of this orchestrator; an asynchronous context manager while it is described."""

    def __init__(
        self,
        state: WorkingState,
        broker: BrokerClient,
        on_disk: OnDisk,
        *,
        heartbeat_s: float = HEARTBEAT_S,
        watch_s: float = WATCH_S,
    ) -> None:
        self._state = state
        self._settings = state.settings
        self._broker = broker
        self._on_disk = on_disk
        self._heartbeat_s, self._watch_s = heartbeat_s, watch_s
        self._id = self._settings.entity_id(Cell.ngsi_type(), self._settings.factory)
        self._identity = ""
        self._claiming = asyncio.Lock()
        self._claimed = asyncio.Event()
        self._seen: tuple[str, str] | None = None
        """The identity of the other cell, and when it was last seen by its own clock."""
        self._unchanged_since_s = 0.0
        self._tasks = BackgroundTasks("cell-presence")

    async def __aenter__(self) -> Self:
        self._identity = await self._on_disk(identity_of, self._state.store.engine)
        await self._tasks.__aenter__()
        self._tasks.start(self._describe_forever)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        if self._claimed.is_set():
            with suppress(Problem, TimeoutError):
                async with asyncio.timeout(GOODBYE_S):
                    await self._write(CellState.STOPPED)

    async def wait(self) -> None:
        """Return as soon as the name is this cell's."""
        await self._claimed.wait()

    async def require(self) -> None:
        """Claim the name unless it is this cell's.

        Raises `CellNameInUse` while another cell has it, and `BrokerError`.
        """
        if self._claimed.is_set():
            return
        async with self._claiming:
            if not self._claimed.is_set():
                await self._claim()

    async def refuse_if_in_use(self) -> None:
        """Raise `CellNameInUse` if another cell has the name; a broker that is away delays nothing."""
        if self._claimed.is_set():
            return
        try:
            async with asyncio.timeout(ASKED_WITHIN_S):
                await self.require()
        except CellNameInUse:
            raise
        except (Problem, TimeoutError):
            return  # without its broker a cell gets no Tasks either

    async def _claim(self) -> None:
        present = await self._read()
        if present is None and not await self._create():
            await asyncio.sleep(SETTLE_S)  # a broker may refuse the second creation before it shows the first
            present = await self._read()
            if present is None:
                raise BrokerUnavailable(
                    503, "Cell not claimed", f"{self._id} is created and deleted by others"
                )
        other = None if present is None else _other_than(self._identity, present)
        if other is not None and not self._has_ended(other):
            raise self._name_in_use()
        await self._write(CellState.RUNNING)
        if present is not None and _value(present, "identity") != self._identity:
            await asyncio.sleep(SETTLE_S)  # another one may replace the same cell now: the last one has it
            present = await self._read()
            if present is None or _value(present, "identity") != self._identity:
                raise self._name_in_use()
        if other is not None:
            log.warning("the cell that had the name before does not write any more", cell=self._id)
        self._seen = None
        self._claimed.set()

    def _name_in_use(self) -> CellNameInUse:
        return CellNameInUse(
            503,
            "Name of the cell in use",
            f"another cell has the name {self._settings.factory!r} in this tenant of "
            f"{self._settings.broker_url}; stop that one, or give this one another name "
            "(HANDOVER_FACTORY) or tenant (HANDOVER_BROKER_TENANT). Until then it sends nothing to the "
            f"broker. The other one counts as ended when {self._id} does not change for "
            f"{self._watch_s:.0f} s",
        )

    def _has_ended(self, other: tuple[str, str]) -> bool:
        now_s = asyncio.get_running_loop().time()
        if other != self._seen:
            self._seen, self._unchanged_since_s = other, now_s
        return now_s - self._unchanged_since_s >= self._watch_s

    async def _describe_forever(self) -> None:
        backoff = Backoff()
        while True:
            try:
                await self._describe()
            except Problem as error:
                log.warning("cell not described", error=str(error))
                await asyncio.sleep(backoff.next_delay_s())
            else:
                backoff.reset()
                await asyncio.sleep(with_jitter(self._heartbeat_s))

    async def _describe(self) -> None:
        if not self._claimed.is_set():
            await self.require()
            return
        present = await self._read()
        if present is not None and _other_than(self._identity, present) is not None:
            self._claimed.clear()
            await self.require()
            return
        await self._write(CellState.RUNNING)

    async def _read(self) -> Mapping[str, Any] | None:
        try:
            return await self._broker.retrieve(self._id)
        except NotFound:
            return None

    async def _create(self) -> bool:
        """Create the cell; return whether no other orchestrator has done so."""
        try:
            await self._broker.create(await self._described(CellState.RUNNING))
        except AlreadyExists:
            return False
        return True

    async def _write(self, state: CellState) -> None:
        await self._broker.upsert([await self._described(state)])

    async def _described(self, state: CellState) -> Cell:
        working = self._state
        now = working.clock()
        hour = now - timedelta(hours=1), now
        try:
            counted: PeriodCount = await self._on_disk(working.store.counts_since, *hour)
        except SQLAlchemyError as error:
            raise outage_problem(error) or error from error
        running = working.active_processes.processes.values()
        values = {
            "id": self._id,
            "identity": self._identity,
            "cell_state": state,
            "last_seen": now,
            "running_processes": sum(process.run is not None for process in running),
            "unfinished_tasks": len(working.active_processes.task_ids()),
            "incidents": sum(bool(process.record.incidents) for process in running),
            "completed_last_hour": counted.completed,
            "failed_last_hour": counted.failed,
        }
        return Cell.model_validate(values)


def _other_than(identity: str, present: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return identity and time of another cell that runs; None if it is this one, or was stopped."""
    values = {name: _value(present, name) for name in ("identity", "cellState", "lastSeen")}
    if values["identity"] in {None, identity} or values["cellState"] == CellState.STOPPED:
        return None
    return str(values["identity"]), str(values["lastSeen"])


def _value(entity: Mapping[str, Any], name: str) -> Any:
    attribute = entity.get(name)
    return attribute.get("value") if isinstance(attribute, Mapping) else None
