"""REST of the cell: its events, the cells on the broker, and the simulated operator."""

from typing import Annotated

from fastapi import FastAPI, Query
from pydantic import ConfigDict

from handover.formats.strict_json import StrictModel
from handover.security.caller import Caller
from handover.security.guard import require, require_somewhere
from handover.security.permissions import Permission
from handover_web.live.event_log import MAX_EVENTS_PER_REQUEST, MAX_SEQ, EventLog
from handover_web.live.views import CellSummary, LiveEvent, OperatorView
from handover_web.simulated_operator import DEFAULT_GLOVE, SimulatedOperator
from handover_web.sources.cells import Cells


class StartOperatorRequest(StrictModel):
    """The glove that the simulated operator wears."""

    model_config = ConfigDict(extra="forbid")

    glove: str = DEFAULT_GLOVE


def add_cell(app: FastAPI, event_log: EventLog, cells_of_broker: Cells, operator: SimulatedOperator) -> None:
    """Add the routes."""

    @app.get("/api/events", tags=["events"])
    async def events(
        caller: Annotated[Caller, require_somewhere(Permission.READ)],
        after: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        before: Annotated[int | None, Query(ge=0, le=MAX_SEQ)] = None,
        limit: Annotated[int, Query(ge=1, le=MAX_EVENTS_PER_REQUEST)] = 200,
    ) -> list[LiveEvent]:
        """Return events, oldest first: after a `seq`, before one, or the newest.

        Events are about everything, so a caller who may not read everything gets none.
        """
        if not caller.may(Permission.READ):
            return []
        if after is not None:
            return await event_log.after(after, limit)
        return await event_log.before(before, limit)

    @app.get("/api/webui/cells", tags=["cells"], dependencies=[require(Permission.READ)])
    async def cells() -> list[CellSummary]:
        """Return the cells on the broker; 503 while it cannot be read."""
        return await cells_of_broker.summaries()

    configure = [require(Permission.CONFIGURE)]

    @app.post("/api/operator", status_code=201, tags=["operator"], dependencies=configure)
    async def start_operator(body: StartOperatorRequest) -> OperatorView:
        """Start the simulated operator: 409 if it is running or the glove is in use."""
        return await operator.start(body.glove)

    @app.delete("/api/operator", tags=["operator"], dependencies=configure)
    async def stop_operator() -> OperatorView:
        """Stop the simulated operator; has no effect if it is not running."""
        return await operator.stop()
