"""The specification database: has the TaskDefinitions that neither the Task nor the broker has.

It may belong to another system, so a failure is tolerated. While it is unavailable or has no table, complete
Tasks continue; other Tasks wait for a limited time and then fail with the reason. Each look-up opens a new
connection, so that the database is used again as soon as it is back.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from handover.database import connect
from handover.database.outage import database_reason
from handover.errors import UsageError
from handover.runtime.retry import Backoff
from handover.tasks.specification_table import SETTING, find
from handover.telemetry import get_logger
from handover_gloves.specifications.definition import Definition

log = get_logger(__name__)

QUERY_TIMEOUT_S = 3.0
INITIAL_RETRY_S, MAX_RETRY_S = 0.5, 2.0
UNAVAILABLE_BACKOFF_S = 5.0
"""Tasks that do not need the database skip it for this time after a failure."""


@dataclass(frozen=True, slots=True)
class DatabaseState:
    """The state of the database: `ok`, `absent` (the file does not exist) or `away`, with the reason."""

    name: Literal["unasked", "ok", "absent", "away"]
    detail: str = ""


class SpecificationDatabase:
    """Looks definitions up; `changed` is called with every new state."""

    def __init__(self, url: str, changed: Callable[[DatabaseState], None] = lambda _: None) -> None:
        self.state = DatabaseState("unasked")
        self._url = url
        self._changed = changed
        self._away_s = float("-inf")

    @property
    def shown(self) -> str:
        """Return its URL without the password."""
        try:
            return make_url(self._url).render_as_string(hide_password=True)
        except ArgumentError:
            return self._url.split("://", 1)[0] + "://…"

    async def look_up(self, definition: str, timeout_s: float = 0.0) -> Definition:
        """Return the definition with the id `definition`, or its last part; an empty one if there is none.

        While the database is unavailable, the look-up is retried for `timeout_s`. Then it returns an empty
        definition, and `state` has the reason.
        """
        clock = asyncio.get_running_loop().time
        until_s = clock() + timeout_s
        if timeout_s == 0 and clock() - self._away_s < UNAVAILABLE_BACKOFF_S:
            return Definition()
        backoff = Backoff(INITIAL_RETRY_S, MAX_RETRY_S)
        while True:
            row = await asyncio.to_thread(self._find, (definition, definition.rsplit(":", 1)[-1]))
            if isinstance(row, Definition):
                self._set_state(DatabaseState("ok"))
                return row
            self._set_state(row)
            if row.name != "away" or clock() >= until_s:
                return Definition()
            self._away_s = clock()
            await backoff.wait()

    def _find(self, ids: tuple[str, ...]) -> Definition | DatabaseState:
        try:
            if self._is_absent():
                return DatabaseState("absent", f"there is no specification database at {self.shown}")
            engine = connect(self._url, setting=SETTING, answers_within_s=QUERY_TIMEOUT_S, is_own=False)
        except UsageError as error:
            return DatabaseState("away", str(error))
        except OSError as error:
            return DatabaseState("away", f"the specification database {self.shown} cannot be read: {error}")
        try:
            row = find(engine, ids)
            return Definition().filled_from(row) if row is not None else Definition()
        except SQLAlchemyError as error:
            reason = database_reason(error)
            return DatabaseState(
                "away",
                f"the specification database {self.shown} cannot be queried: {reason}; correct that, or "
                "make the table with handover specification import",
            )
        finally:
            engine.dispose()

    def _is_absent(self) -> bool:
        """Return True if it is an SQLite file that does not exist; a look-up must not create it."""
        if not self._url.startswith("sqlite"):
            return False
        file = make_url(self._url).database
        return bool(file) and file != ":memory:" and not Path(str(file)).exists()

    def _set_state(self, state: DatabaseState) -> None:
        if state == self.state:
            return
        if state.name == "away":
            log.warning("specification database unavailable", detail=state.detail)
        before, self.state = self.state, state
        if state.name != before.name:
            self._changed(state)
