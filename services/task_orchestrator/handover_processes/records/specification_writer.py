"""Specification writer: writes rows of the specification database, which may belong to another system.

One thread writes. While the database is unavailable every write fails at once, except one attempt a second,
so that many waiting messages cost nothing. An Alert is active from the first failure to the next success.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Self

from sqlalchemy import Engine
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import SPECIFICATIONS_NOT_WRITTEN
from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient
from handover.database import connect
from handover.database.outage import database_reason
from handover.errors import HandoverError, UsageError
from handover.messages import message
from handover.settings import Settings
from handover.tasks.specification import Specification
from handover.tasks.specification_table import MAX_ID, SETTING, create_if_missing, remove, save
from handover.telemetry import get_logger

log = get_logger(__name__)

STATEMENT_TIMEOUT_S = 3.0
ATTEMPT_EVERY_S = 1.0
ALERT = "specification database not written"


class SpecificationsUnavailable(HandoverError):
    """The database does not answer; the write may succeed later."""


class SpecificationRefused(HandoverError):
    """The database refuses a row."""


class SpecificationWriter:
    """Writes rows; an asynchronous context manager."""

    def __init__(self, settings: Settings, broker: BrokerClient) -> None:
        self._settings = settings
        self._broker = broker
        self._alerts = reporting_writer("task-orchestrator", settings, broker)
        self._disk = ThreadPoolExecutor(1, "specifications")
        self._engine: Engine | None = None
        self._failed_s = float("-inf")
        self._why = ""
        self._is_available: bool | None = None

    async def __aenter__(self) -> Self:
        await self._alerts.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._alerts.__aexit__()
        self._disk.shutdown(wait=False, cancel_futures=True)

    async def write(self, row: Mapping[str, Any]) -> None:
        """Write the `values` of the row `id`, or delete the row that has none.

        Raises `SpecificationsUnavailable`, or `SpecificationRefused` when the row cannot be written.
        """
        try:
            await asyncio.get_running_loop().run_in_executor(self._disk, self._write, row)
        except SpecificationsUnavailable as error:
            self._set_available(False, str(error))
            raise
        self._set_available(True)

    def _write(self, row: Mapping[str, Any]) -> None:
        if time.monotonic() - self._failed_s < ATTEMPT_EVERY_S:
            raise SpecificationsUnavailable(self._why)
        values = row.get("values")
        row_id = str(row["id"])
        if len(row_id) > MAX_ID:
            raise SpecificationRefused(f"the id {row_id} has more than {MAX_ID} characters")
        act: Callable[[Engine], None] = (
            partial(remove, ids=[row_id])
            if values is None
            else partial(save, changed={row_id: Specification.of(values)})
        )
        try:
            self._perform(act)
        except (UsageError, OSError, OperationalError, InterfaceError) as error:
            self._fail(error)
        except SQLAlchemyError as error:
            if isinstance(error, DBAPIError) and error.connection_invalidated:
                self._fail(error)
            raise SpecificationRefused(
                message(
                    "task.specification_refused",
                    "the specification database does not accept the row {row}: {why}; correct its table "
                    "task_definitions, then retry",
                    row=row_id,
                    why=_reason(error),
                )
            ) from error

    def _perform(self, act: Callable[[Engine], None]) -> None:
        if self._engine is None:
            url = self._settings.specifications
            engine = connect(url, setting=SETTING, answers_within_s=STATEMENT_TIMEOUT_S, is_own=False)
            try:
                create_if_missing(engine)
            except BaseException:
                engine.dispose()
                raise
            self._engine = engine
        act(self._engine)

    def _fail(self, error: Exception) -> None:
        if self._engine is not None:
            self._engine.dispose()
            self._engine = None
        self._failed_s, self._why = time.monotonic(), _reason(error)
        raise SpecificationsUnavailable(self._why) from error

    def _set_available(self, is_available: bool, why: str = "") -> None:
        if is_available is self._is_available:
            return
        self._is_available = is_available
        if is_available:
            self._alerts.put(ALERT, lambda: clear_alert(self._broker, self._settings, key=ALERT))
            return
        log.warning("specification database unavailable, tasks wait", reason=why)
        description = SPECIFICATIONS_NOT_WRITTEN.describe(
            "alert.specifications_not_written",
            why=why,
            setting=SETTING,
        )
        self._alerts.put(
            ALERT,
            lambda: raise_alert(
                self._broker,
                self._settings,
                SPECIFICATIONS_NOT_WRITTEN,
                key=ALERT,
                source=self._settings.entity_id("Device", "specification-database"),
                description=description,
            ),
        )


def _reason(error: Exception) -> str:
    return database_reason(error)
