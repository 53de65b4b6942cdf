"""Subjects: entities with a history, which are current, deleted, or were only ever provided as history.

An entity that was deleted and created again is one subject with several sequence numbers.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

from handover_broker.model.entity import Entity
from handover_broker.temporal.history import TemporalOnlyEntity


@dataclass(frozen=True, slots=True)
class Subject:
    """An entity with a history; each of its creations has one of the `entity_seqs`.

    `was_never_current`: it never was a current entity; its history was provided by clients.
    """

    id: str
    types: tuple[str, ...]
    scopes: tuple[str, ...]
    created_at: str
    modified_at: str
    deleted_at: str | None
    entity_seqs: tuple[int, ...]
    expires_at: str | None = None
    was_never_current: bool = False
    earlier_types: tuple[str, ...] = ()
    """Types that the subject has lost, or had before its present creation; rights count for all of them."""

    def with_all_types(self) -> Entity:
        """Return the entity with all types that it ever had, for decisions on rights."""
        return replace(self.as_entity(), types=tuple(dict.fromkeys((*self.types, *self.earlier_types))))

    def as_entity(self) -> Entity:
        """Return the current or last entity without its attributes."""
        return Entity(
            self.id,
            self.types,
            {},
            self.created_at,
            self.modified_at,
            self.entity_seqs[-1],
            self.scopes,
            self.expires_at,
        )

    def as_temporal_only(self, at: str) -> TemporalOnlyEntity:
        """Return the stored form of an entity with a history only, changed at `at`."""
        return TemporalOnlyEntity(
            self.types,
            self.scopes,
            self.created_at,
            at,
            self.deleted_at,
            self.expires_at,
            self.earlier_types,
        )


def subjects_of(entities: Iterable[Entity], temporal_only: Iterable[tuple[int, str, bytes]]) -> list[Subject]:
    """Return the subjects of current and temporal-only entities, in the order of their first creation.

    Places before an expired one are left out, even if they are still on disk.
    """
    subjects: dict[str, Subject] = {}
    now_s = time.time()
    for entity_seq, entity_id, body in temporal_only:
        stored = TemporalOnlyEntity.restored(body)
        if stored.has_expired_at(now_s):
            subjects.pop(entity_id, None)
            continue
        earlier_subject = subjects.get(entity_id)
        entity_seqs = (entity_seq,) if earlier_subject is None else (*earlier_subject.entity_seqs, entity_seq)
        created_at = stored.created_at if earlier_subject is None else earlier_subject.created_at
        subjects[entity_id] = Subject(
            entity_id,
            stored.types,
            stored.scopes,
            created_at,
            stored.modified_at,
            stored.deleted_at,
            entity_seqs,
            stored.expires_at,
            was_never_current=stored.deleted_at is None,
            earlier_types=_earlier(earlier_subject, stored.former_types),
        )
    for entity in entities:
        earlier_subject = subjects.get(entity.id)
        earlier = (
            ()
            if earlier_subject is None
            else tuple(entity_seq for entity_seq in earlier_subject.entity_seqs if entity_seq != entity.seq)
        )
        subjects[entity.id] = Subject(
            entity.id,
            entity.types,
            entity.scopes,
            entity.created_at,
            entity.modified_at,
            None,
            (*earlier, entity.seq),
            entity.expires_at,
            earlier_types=_earlier(earlier_subject, entity.former_types),
        )
    return sorted(subjects.values(), key=lambda subject: subject.entity_seqs[0])


def _earlier(earlier_subject: Subject | None, former: tuple[str, ...]) -> tuple[str, ...]:
    return (
        former
        if earlier_subject is None
        else (*earlier_subject.earlier_types, *earlier_subject.types, *former)
    )
