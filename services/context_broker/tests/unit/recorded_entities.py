"""Entities with recorded changes, for tests of the history."""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import count
from typing import Any

from handover_broker.model import changes
from handover_broker.model.changes import Outcome
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity, Event, Instance
from handover_broker.model.entity_parser import read_change, read_entity
from handover_broker.model.validation import timestamp
from handover_broker.storage.entries import Entries
from handover_broker.storage.journal import Journal
from handover_broker.temporal.history import HistoryRecorder
from handover_broker.temporal.history_reader import EvolutionPage, HistoryRequest, read_evolution
from handover_broker.temporal.query import TemporalQuery
from handover_broker.temporal.subjects import Subject, subjects_of
from handover_datamodels.contexts import HANDOVER_URL, TermMap

CONTEXT = Context(0, TermMap(HANDOVER_URL), HANDOVER_URL, b"", HANDOVER_URL)
TERMS = CONTEXT.terms
PLACES = count(1)
START = datetime(2026, 1, 1, tzinfo=UTC)


def event(before: Entity | None, after: Entity | None) -> Event:
    """Return a change that may have written every attribute there is."""
    return Event(before, after, frozenset(after.attributes if after else ()))


@dataclass
class RecordedEntity:
    """An entity that is changed step by step, with a note of every instance that was written."""

    journal: Journal
    recorder: HistoryRecorder = field(default_factory=HistoryRecorder)
    pending: Entries = field(default_factory=Entries)
    place: int = field(default_factory=lambda: next(PLACES))
    now: datetime = START
    entity: Entity | None = None
    written: list[tuple[str, Instance]] = field(default_factory=list)
    deleted: list[tuple[str, str | None, str]] = field(default_factory=list)

    def step(self) -> str:
        self.now += timedelta(seconds=1)
        return timestamp(self.now)

    def take(self, after: Entity | None, at: str) -> None:
        before = self.entity
        self.recorder.record("", event(before, after), self.pending)
        old = {} if before is None else before.attributes
        new = {} if after is None else after.attributes
        for name, instances in new.items():
            self.written += [(name, one) for one in instances if one["modifiedAt"] == at]
        if after is not None:
            for name, instances in old.items():
                left = {one.get("datasetId") for one in new.get(name, [])}
                gone = [one.get("datasetId") for one in instances if one.get("datasetId") not in left]
                self.deleted += [(name, dataset, at) for dataset in gone]
        self.entity = after

    def create(self, document: dict[str, Any]) -> None:
        at = self.step()
        given = {"id": f"urn:x:{self.place}", "type": "Car", **document}
        self.take(changes.created(read_entity(given, TERMS), at, self.place), at)

    def change(self, document: dict[str, Any], how: str = "appended") -> None:
        assert self.entity is not None
        at = self.step()
        outcome: Outcome = getattr(changes, how)(self.entity, read_change(document, TERMS), at)
        if outcome.entity is not self.entity:
            self.take(outcome.entity, at)

    def commit(self) -> None:
        self.journal.commit(self.pending)
        self.pending = Entries()

    def subject(self) -> Subject:
        self.commit()
        temporal_only = self.journal.archive.temporal_only_entities("", f"urn:x:{self.place}")
        (found,) = subjects_of(() if self.entity is None else (self.entity,), temporal_only)
        return found

    def read(self, query: TemporalQuery) -> EvolutionPage:
        return read_evolution(self.journal.archive, self.subject(), HistoryRequest(query, lambda _: True))
