"""The PhysiologicalSession of each recording in the broker, while the person allows entities there."""

from contextlib import suppress
from typing import Final

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.broker.latest_value_writer import LatestValueWriter
from handover.telemetry import get_logger
from handover_body.exchange.deletions import Deletions
from handover_body.exchange.health_entities import HealthEntities
from handover_body.exchange.ngsi_ld import session
from handover_body.people.consent import Purpose
from handover_body.people.people import People, Person
from handover_body.recording.recordings import Recordings
from handover_body.settings import HumanStateSettings
from handover_body.storage.store import RecordingRow
from handover_datamodels.renamed import renamed_attributes

log = get_logger(__name__)

TYPE: Final = "PhysiologicalSession"


class SessionEntities:
    """Writes and deletes the entities. While the broker is away they wait."""

    def __init__(
        self,
        settings: HumanStateSettings,
        people: People,
        recordings: Recordings,
        broker: BrokerClient,
        writer: LatestValueWriter,
        *,
        health: HealthEntities,
        deletions: Deletions,
    ) -> None:
        self._settings = settings
        self._people = people
        self._recordings = recordings
        self._broker = broker
        self._writer = writer
        self._health = health
        self._deletions = deletions
        self._published: set[str] = set()

    def id_of(self, recording: str) -> str:
        """Return the id of the entity of a recording."""
        return self._settings.entity_id(TYPE, recording)

    def changed(self, row: RecordingRow) -> None:
        """Write the entity of a recording, or delete it where it is no longer allowed."""
        person = next(
            (candidate for candidate in self._people.all() if candidate.pseudonym == row.subject), None
        )
        self._apply(row, person)

    def apply(self, name: str) -> None:
        """Write and delete the entities of a person whose consent may have changed."""
        person = self._people.find(name)
        if person is not None:
            for row in self._recordings.of(person.pseudonym):
                if (Purpose.BROKER in person.purposes()) != (row.id in self._published):
                    self._apply(row, person)

    def deleted(self, recording: str) -> None:
        """Delete the entity of a recording with its history."""
        self._published.discard(recording)
        self._deletions.put(self.id_of(recording))

    async def synchronize(self) -> None:
        """Write all entities, and delete those of recordings that are gone."""
        for row in self._recordings.all():
            self.changed(row)
        prefix = self.id_of("R-")
        for entity in await self._broker.query(type=TYPE):
            identifier = str(entity["id"])
            recording = identifier.removeprefix(prefix.removesuffix("R-"))
            if identifier.startswith(prefix) and recording not in self._published:
                self.deleted(recording)
        await rename_attributes(self._broker)  # last: what a broker does not rename delays no deletion

    def _apply(self, row: RecordingRow, person: Person | None) -> None:
        if person is None or Purpose.BROKER not in person.purposes():
            if row.id in self._published:
                self.deleted(row.id)
            return
        self._published.add(row.id)
        entity = session(
            self.id_of(row.id),
            self._settings.entity_id("Person", person.name),
            row.started_us / 1e6,
            end_s=None if row.ended_us is None else row.ended_us / 1e6,
            recording=f"{self._settings.human_state}/people/{person.name}/recordings/{row.id}/file",
            sha256=row.sha256,
        ).to_normalized()
        self._writer.put(self.id_of(row.id), lambda: self._health.upsert(entity))


async def rename_attributes(broker: BrokerClient) -> None:
    """Give attributes that have an old name their present one, in all entities of the type in the tenant.

    The old ones are named by their IRIs, since their short names may mean terms of the core context of a
    broker. An entity that a crash leaves with both names is completed at the next start. What a broker
    refuses to rename is logged and stays. Raises `BrokerUnavailable`.
    """
    present = renamed_attributes(TYPE)
    renamed = 0
    for entity in await broker.query(type=TYPE, attrs=[*present, *present.values()]):
        held = {_short(name): attribute for name, attribute in entity.items()}
        old_names = {old: new for old, new in present.items() if _short(old) in held}
        added = {_short(new): held[_short(old)] for old, new in old_names.items() if _short(new) not in held}
        try:
            with suppress(NotFound):
                if added:
                    await broker.append(entity["id"], added)
                for old in old_names:
                    await broker.delete_attribute(entity["id"], old)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            names = ", ".join(map(_short, old_names))
            log.warning("attributes not renamed", entity=entity["id"], names=names, error=str(error))
        else:
            renamed += bool(old_names)
    if renamed:
        names = ", ".join(f"{_short(old)} to {_short(new)}" for old, new in present.items())
        log.info("attributes renamed", type=TYPE, entities=renamed, names=names)


def _short(name: str) -> str:
    """Return an attribute of the default vocabulary without it; brokers answer with and without."""
    return name.rpartition("/")[2]
