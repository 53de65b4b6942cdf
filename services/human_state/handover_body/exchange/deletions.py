"""Deletes entities of persons from the broker, and says what remains where the broker cannot."""

from contextlib import suppress

from handover.alerts import raise_alert
from handover.alerts.catalogue import DELETION_REFUSED
from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.broker.latest_value_writer import LatestValueWriter
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)


class Deletions:
    """Deletions in the background, repeated until the broker has performed or refused them."""

    def __init__(self, settings: Settings, broker: BrokerClient, writer: LatestValueWriter) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = writer
        self._reported: set[str] = set()

    def put(self, identifier: str) -> None:
        """Delete an entity with its history."""
        self._writer.put(identifier, lambda: self._delete(identifier))

    def forget_history(self, identifier: str) -> None:
        """Delete the history of an entity that stays."""
        self._writer.put(f"{identifier} history", lambda: self._forget(identifier))

    async def _delete(self, identifier: str) -> None:
        try:
            with suppress(NotFound):
                await self._broker.delete(identifier)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            await self._report(
                identifier,
                DELETION_REFUSED.describe(
                    "alert.entity_not_deleted",
                    entity=identifier,
                    why=str(error),
                ),
            )
        await self._forget(identifier)

    async def _forget(self, identifier: str) -> None:
        try:
            with suppress(NotFound):
                await self._broker.delete_evolution(identifier)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            await self._report(
                f"{identifier} history",
                DELETION_REFUSED.describe(
                    "alert.history_not_deleted",
                    entity=identifier,
                    why=str(error),
                ),
            )

    async def _report(self, subject: str, description: str) -> None:
        """Raise the Alert that something remains, once."""
        if subject in self._reported:
            return
        log.warning("not deleted from the broker", entity=subject, reason=description)
        await raise_alert(
            self._broker,
            self._settings,
            DELETION_REFUSED,
            key=f"{subject.rpartition(':')[2]} not deleted",
            source=subject.partition(" ")[0],
            description=description,
        )
        self._reported.add(subject)
