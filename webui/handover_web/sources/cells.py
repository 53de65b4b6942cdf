"""The cells on the broker, for the list of them: what each orchestrator says, and how many Alerts are active.

They are read from the broker alone, so that one page shows cells whose services it cannot reach.
"""

import asyncio
from collections import Counter
from collections.abc import Mapping
from contextlib import AsyncExitStack
from datetime import UTC, datetime, timedelta
from itertools import chain
from typing import Any, Final, Literal, Self

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.broker.cells import cell_of
from handover.errors import Problem
from handover.telemetry import get_logger
from handover_datamodels.entities import Alert, Cell, DataModelError
from handover_datamodels.states import CellState
from handover_web.live.views import CellSummary
from handover_web.settings import WebuiSettings

log = get_logger(__name__)

SILENT_AFTER: Final = timedelta(seconds=100)
"""An orchestrator describes its cell every 30 s."""


class Cells:
    """Lists the cells of the tenant, and of the `cell_tenants`; an asynchronous context manager."""

    def __init__(self, settings: WebuiSettings, broker: BrokerClient) -> None:
        own = settings.broker_tenant or ""
        self._brokers = {own: broker}
        self._others = {
            tenant: BrokerClient(
                settings.model_copy(update={"broker_tenant": tenant}), credentials=broker.credentials
            )
            for tenant in settings.cell_tenants
            if tenant != own
        }
        self._brokers |= self._others
        self._exits = AsyncExitStack()

    async def __aenter__(self) -> Self:
        for cell in self._others.values():
            await self._exits.enter_async_context(cell)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._exits.aclose()

    async def summaries(self) -> list[CellSummary]:
        """Return the cells by tenant and name. Raises `Problem` 503 if a tenant cannot be read."""
        tenants = sorted(self._brokers)
        try:
            summaries = await asyncio.gather(*(self._of(tenant) for tenant in tenants))
        except BrokerError as error:
            raise Problem(503, "Cells not read", str(error)) from error
        return list(chain.from_iterable(summaries))

    async def _of(self, tenant: str) -> list[CellSummary]:
        broker = self._brokers[tenant]
        try:
            cells = await broker.query(type=Cell.ngsi_type())
        except NotFound:
            return []  # our broker has no such tenant before the cell in it has started
        alerts = await broker.query(type=Alert.ngsi_type(), attrs=["dateIssued", "validTo"])
        active = Counter(cell_of(str(alert["id"])) for alert in alerts if "validTo" not in alert)
        now = datetime.now(UTC)
        summaries = []
        for entity in cells:
            try:
                summaries.append(_summary(tenant, Cell.from_ngsild(entity), active, now))
            except DataModelError as error:
                log.warning("invalid entity", entity=entity.get("id"), error=str(error))
        return sorted(summaries, key=lambda summary: summary["name"])


def _summary(tenant: str, cell: Cell, active: Mapping[str | None, int], now: datetime) -> CellSummary:
    name = cell_of(cell.id) or cell.id
    state: Literal["running", "stopped", "silent"] = "running"
    if cell.cell_state.value is CellState.STOPPED:
        state = "stopped"
    elif now - cell.last_seen.value > SILENT_AFTER:
        state = "silent"
    return {
        "name": name,
        "tenant": tenant,
        "state": state,
        "lastSeen": f"{cell.last_seen.value.astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "runningProcesses": _number(cell.running_processes),
        "unfinishedTasks": _number(cell.unfinished_tasks),
        "incidents": _number(cell.incidents),
        "completedLastHour": _number(cell.completed_last_hour),
        "failedLastHour": _number(cell.failed_last_hour),
        "alerts": active.get(name, 0),
    }


def _number(count: Any) -> int:
    return 0 if count is None else int(count.value)
