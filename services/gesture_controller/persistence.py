"""Writing to the database beside the event loop."""

import asyncio
from collections.abc import Callable
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError

from handover.errors import Problem
from handover.messages import message
from handover.telemetry import get_logger

log = get_logger(__name__)

T = TypeVar("T")


async def persist(action: Callable[[], T]) -> T:
    """Run `action` in a thread and return its result; raise `Problem` 503 if the database refuses it."""
    try:
        return await asyncio.to_thread(action)
    except SQLAlchemyError as error:
        log.exception("database write failed")
        reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        raise Problem(
            503,
            "Database away",
            message(
                "people.database_away",
                "nothing was changed: the database cannot be written ({reason}); try again",
                reason=reason,
            ),
        ) from None
