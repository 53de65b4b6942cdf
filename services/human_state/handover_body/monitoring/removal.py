"""Deletes what is known of a person: in the database, in what waits to be written, and in the broker."""

import asyncio
from collections.abc import Awaitable, Callable

from handover_body.monitoring.entities import HumanStates
from handover_body.monitoring.history import HistoryWriter
from handover_body.people.people import People, Person
from handover_body.storage.store import Store


class Removal:
    """Deletes data of persons everywhere. While the broker is away, its part waits."""

    def __init__(
        self,
        people: People,
        store: Store,
        history: HistoryWriter,
        entities: HumanStates,
        delete_recordings: Callable[[str], Awaitable[None]],
    ) -> None:
        self._people = people
        self._store = store
        self._history = history
        self._entities = entities
        self._delete_recordings = delete_recordings

    async def person(self, name: str) -> None:
        """Delete a person with everything."""
        person = await self._people.delete(name)
        await self.data(person)

    async def data(self, person: Person) -> None:
        """Delete the recordings of a person, and the history here and in the broker."""
        await self._delete_recordings(person.pseudonym)
        await self._history.forget(person.pseudonym)
        await asyncio.to_thread(self._store.delete_history, person.pseudonym)
        self._entities.delete(person.pseudonym)
