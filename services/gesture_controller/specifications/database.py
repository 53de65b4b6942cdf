"""The specification database: asked when neither the Task nor the broker says what to show.

It is somebody else's as often as not, so nothing here depends on it: while it is away or has no table, Tasks
that say all themselves go on, the others wait a little and then say plainly what they lack. Each look-up
connects anew, so that it comes back by itself.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from handover.database import connect
from handover.errors import UsageError
from handover.telemetry import get_logger
from services.gesture_controller.specifications import table
from services.gesture_controller.specifications.definition import Definition

log = get_logger(__name__)

SETTING = "HANDOVER_SPECIFICATION_URL"
ANSWERS_WITHIN_S = 3.0
RETRY_S = 0.5
AWAY_FOR_S = 5.0
"""A database that did not answer is left alone for so long by Tasks that can do without."""


@dataclass(frozen=True, slots=True)
class State:
    """How it is with the database: `ok`, `absent` (nothing was ever put there) or `away`, and why."""

    name: Literal["unasked", "ok", "absent", "away"]
    detail: str = ""


class SpecificationDatabase:
    """Looks definitions up; `changed` is called with the state whenever that is another."""

    def __init__(self, url: str, changed: Callable[[State], None] = lambda _: None) -> None:
        self.state = State("unasked")
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

    async def look_up(self, definition: str, patience_s: float = 0.0) -> Definition:
        """Return what is found under the URN `definition`, or its last part; an empty one if nothing is.

        While the database is away it is asked again for `patience_s`; then an empty one is returned, and
        `state` says why.
        """
        clock = asyncio.get_running_loop().time
        until_s = clock() + patience_s
        if patience_s == 0 and clock() - self._away_s < AWAY_FOR_S:
            return Definition()
        while True:
            found = await asyncio.to_thread(self._find, (definition, definition.rsplit(":", 1)[-1]))
            if isinstance(found, Definition):
                self._is(State("ok"))
                return found
            self._is(found)
            if found.name != "away" or clock() >= until_s:
                return Definition()
            self._away_s = clock()
            await asyncio.sleep(RETRY_S)

    def _find(self, ids: tuple[str, ...]) -> Definition | State:
        try:
            if self._is_absent():
                return State("absent", f"there is no specification database at {self.shown}")
            engine = connect(self._url, setting=SETTING, answers_within_s=ANSWERS_WITHIN_S, is_own=False)
        except UsageError as error:
            return State("away", str(error))
        except OSError as error:
            return State("away", f"the specification database {self.shown} cannot be read: {error}")
        try:
            return table.find(engine, ids) or Definition()
        except SQLAlchemyError as error:
            reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
            return State(
                "away",
                f"the specification database {self.shown} cannot be asked: {reason}; mend that, or "
                "make the table with handover specification import",
            )
        finally:
            engine.dispose()

    def _is_absent(self) -> bool:
        """Say whether it is a file that is not there: to look into it must not create it."""
        if not self._url.startswith("sqlite"):
            return False
        file = make_url(self._url).database
        return bool(file) and file != ":memory:" and not Path(str(file)).exists()

    def _is(self, state: State) -> None:
        if state == self.state:
            return
        if state.name == "away":
            log.warning("specification database away", detail=state.detail)
        before, self.state = self.state, state
        if state.name != before.name:
            self._changed(state)
