"""Offers: definitions of other systems in the broker, from their discovery to the decision of an engineer.

An offer is one content of one entity. While the entity has another content the offer is superseded, and when
the content returns the offer is open again, unless an engineer has rejected it. So systems that change an
entity in turn make no more offers than there are contents. What was accepted last is in force.

Nothing here performs I/O: entities are read into candidates, and steps get the changes of offers.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

import orjson

from handover.errors import HandoverError
from handover.files.content_digest import ATTRIBUTE, digest_of
from handover.messages import message
from handover.tasks.specification import FIELDS, Specification
from handover_bpmn.forms.json_schema import schema_fault
from handover_bpmn.model import Fault
from handover_bpmn.notation.document import MAX_BYTES
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_datamodels.entities import TYPES, DataModelError, TaskDefinition
from handover_processes.allocation.agents import position_of, read_shift, skill_name
from handover_processes.allocation.task_kinds import TaskKind
from handover_processes.records.offers import Decision, OfferRecord, OfferStatus
from handover_processes.records.step import Step

DEFINITIONS = ("ProcessDefinition", "TaskDefinition")
"""Types that have an effect only after an engineer has accepted them."""
RESOURCES = ("ResourceSpecification", "Location")
"""Types that describe the factory."""
OFFERED_TYPES = (*DEFINITIONS, *RESOURCES)

ID_LENGTH = 16
MAX_ID_LENGTH = 2000
MAX_NAME = 200
MAX_SCHEMA_BYTES = 64 * 1024
MAX_CONTENT_BYTES = 256 * 1024
"""Bytes of an entity without its BPMN file."""
MAX_UNDECIDED = 20
"""Offers of one entity that are kept although they were superseded before a decision."""
MANY_TIMES = 3
"""A content that has returned so often is changed by several systems."""

Entity = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A definition of another system as it was read: what an offer is made of."""

    id: str
    entity: str
    type: str
    name: str
    content: Mapping[str, Any]
    bpmn: str | None = None
    """The BPMN file, or its URL."""
    file: bytes | None = field(default=None, repr=False)
    faults: tuple[Fault, ...] = ()
    warnings: tuple[Fault, ...] = ()


def type_of_entity(entity: Entity) -> str | None:
    """Return which of the offered types an entity has; None if it has none, or no id that can be stored."""
    entity_id = entity.get("id")
    if not isinstance(entity_id, str) or not 0 < len(entity_id) <= MAX_ID_LENGTH or "\0" in entity_id:
        return None
    types_ = entity.get("type")
    types = types_ if isinstance(types_, list) else [types_]
    return next((type_ for type_ in OFFERED_TYPES if type_ in types), None)


def read_candidate(entity: Entity) -> Candidate | None:
    """Return the candidate of a normalized entity, without its file; None if it has none of the types."""
    type_ = type_of_entity(entity)
    if type_ is None:
        return None
    model = TYPES[type_]
    attributes = {field_.alias or name for name, field_ in model.model_fields.items()} - {
        "@context",
        ATTRIBUTE,
    }
    content = {name: value for name, value in entity.items() if name in attributes}
    content |= {"id": entity["id"], "type": type_}
    offer_id = digest_of(content)[:ID_LENGTH]
    name, bpmn = _text(content, "name"), _text(content, "bpmn")
    candidate = Candidate(
        offer_id, entity["id"], type_, (name or entity["id"]).replace("\0", " ")[:MAX_NAME], content, bpmn
    )
    if bpmn is not None and not is_url(bpmn):
        candidate = replace(
            candidate, content={name: value for name, value in content.items() if name != "bpmn"}
        )
    if len(orjson.dumps(candidate.content)) > MAX_CONTENT_BYTES:
        return replace(candidate, content={"id": entity["id"], "type": type_}, faults=(_fault(_too_large()),))
    try:
        read = model.from_ngsild(content)
    except DataModelError as error:
        return replace(candidate, faults=(_fault(str(error)),))
    if isinstance(read, TaskDefinition):
        return replace(candidate, faults=(*_schema_faults(read), *_specification_faults(read)))
    return replace(candidate, warnings=tuple(_warnings_of(type_, content)))


def is_url(bpmn: str) -> bool:
    """Return whether the text of `bpmn` is an address and not the file itself."""
    return not bpmn.lstrip("\ufeff \t\r\n").startswith("<")


def check_file(candidate: Candidate, file: bytes) -> Candidate:
    """Return the candidate with the faults and warnings of its BPMN file."""
    stored = file if len(file) <= MAX_BYTES else None
    try:
        read = read_bpmn(file)
    except BadBpmn as bad:
        return replace(candidate, file=stored, faults=tuple(bad.faults), warnings=bad.warnings)
    except HandoverError as error:
        return replace(candidate, file=file, faults=(_fault(str(error)),))
    return replace(candidate, file=file, warnings=read.warnings)


def with_fault(candidate: Candidate, text: str) -> Candidate:
    """Return the candidate with one more fault, of the whole entity."""
    return replace(candidate, faults=(*candidate.faults, _fault(text)))


class Offers:
    """All offers, as the database has them."""

    def __init__(self, stored: Sequence[OfferRecord] = ()) -> None:
        self._records = {record.id: record for record in stored}
        self.foreign = {record.entity for record in stored if record.status is not OfferStatus.WITHDRAWN}
        """Definitions in the broker that other systems have written, as far as they were seen."""

    def find(self, offer: str) -> OfferRecord | None:
        """Return an offer by its id."""
        return self._records.get(offer)

    def listed(self, status: OfferStatus | None = None, entity: str | None = None) -> list[OfferRecord]:
        """Return the offers in a status and of an entity, the latest first."""
        offers = [
            record
            for record in self._records.values()
            if status in {None, record.status} and entity in {None, record.entity}
        ]
        return sorted(offers, key=lambda record: (record.found_at, record.id), reverse=True)

    def in_force(self, entity: str) -> OfferRecord | None:
        """Return the accepted content of an entity."""
        return next(
            (record for record in self._records.values() if record.entity == entity and record.in_force), None
        )

    def task_kinds(self) -> dict[str, TaskKind]:
        """Return the accepted TaskDefinitions by id."""
        return {
            record.entity: TaskKind.of(TaskDefinition.from_ngsild(record.content))
            for record in self._records.values()
            if record.in_force and record.type == "TaskDefinition"
        }

    def effective(self, entities: Iterable[Entity], *, needs_acceptance: bool) -> Iterator[Entity]:
        """Yield what allocation uses: resources of others as an engineer has decided about them.

        Without a decision a ResourceSpecification or Location is used, unless it `needs_acceptance`. One
        with faults is not used. Entities of other types, and our own, are yielded as they are.
        """
        for entity in entities:
            entity_id = entity.get("id")
            if entity.get("type") not in RESOURCES or entity_id not in self.foreign:
                yield entity
                continue
            candidate = read_candidate(entity)
            record = None if candidate is None else self._records.get(candidate.id)
            is_rejected = record is not None and record.status is OfferStatus.REJECTED
            is_accepted = record is not None and record.in_force
            has_faults = candidate is None or bool(candidate.faults)
            if is_accepted or not (is_rejected or has_faults or needs_acceptance):
                yield entity
            elif (accepted := self.in_force(str(entity_id))) is not None:
                yield accepted.content

    def apply(self, step: Step) -> None:
        """Take over what a step has written to the database."""
        self._records |= step.offers
        for offer in step.offers_deleted:
            self._records.pop(offer, None)

    # Changes, within a step

    def receive(self, step: Step, candidate: Candidate, now: datetime, *, is_deployed: bool = False) -> None:
        """Offer the present content of an entity; `is_deployed`: it would change nothing."""
        record = self._at(step, candidate.id)
        self._close_others(step, candidate.entity, candidate.id, OfferStatus.SUPERSEDED)
        if record is None:
            if is_deployed:
                return
            record = OfferRecord(
                candidate.id,
                candidate.entity,
                candidate.type,
                candidate.name,
                OfferStatus.OPEN,
                now,
                candidate.content,
            )
        elif record.status is OfferStatus.REJECTED or record.in_force:
            return
        elif record.status is not OfferStatus.OPEN:
            record = replace(record, status=OfferStatus.OPEN, found_at=now, times=record.times + 1)
        elif record.has_file or candidate.file is None:
            return
        if candidate.file is not None or not record.has_file:
            record = replace(record, faults=candidate.faults, warnings=candidate.warnings)
        in_turn = _fault(_changed_in_turn())
        if record.times >= MANY_TIMES and in_turn not in record.warnings:
            record = replace(record, warnings=(*record.warnings, in_turn))
        step.offers[record.id] = replace(record, has_file=record.has_file or candidate.file is not None)
        if candidate.file is not None:
            step.offer_files[record.id] = candidate.file
        self._prune(step, candidate.entity)

    def withdraw(self, step: Step, entity: str) -> None:
        """Close the open offer of an entity that is gone from the broker, or that is ours again."""
        self._close_others(step, entity, None, OfferStatus.WITHDRAWN)

    def decide(self, step: Step, offer: str, decision: Decision) -> OfferRecord:
        """Record the decision about an offer; what is accepted is in force from then on."""
        record = self._at(step, offer)
        assert record is not None  # noqa: S101 - the caller has found it
        is_accepted = decision.status is OfferStatus.ACCEPTED
        if is_accepted:
            for other in self._of(step, record.entity):
                if other.in_force and other.id != offer:
                    step.offers[other.id] = replace(other, in_force=False)
        decided = replace(
            record,
            status=decision.status,
            decisions=(*record.decisions, decision),
            in_force=is_accepted or (record.in_force and decision.status is not OfferStatus.REJECTED),
        )
        step.offers[offer] = decided
        return decided

    def present(self, step: Step, offer: str) -> OfferRecord | None:
        """Return an offer with what the step has changed."""
        return self._at(step, offer)

    def _at(self, step: Step, offer: str) -> OfferRecord | None:
        return step.offers.get(offer) or self._records.get(offer)

    def _of(self, step: Step, entity: str) -> list[OfferRecord]:
        return [record for record in ({**self._records, **step.offers}).values() if record.entity == entity]

    def _close_others(self, step: Step, entity: str, but: str | None, status: OfferStatus) -> None:
        for record in self._of(step, entity):
            if record.status is OfferStatus.OPEN and record.id != but:
                step.offers[record.id] = replace(record, status=status)

    def _prune(self, step: Step, entity: str) -> None:
        """Delete the oldest offers of an entity that nobody has decided about and that are not open."""
        undecided = [
            record
            for record in self._of(step, entity)
            if record.status in {OfferStatus.SUPERSEDED, OfferStatus.WITHDRAWN} and not record.is_decided
        ]
        undecided.sort(key=lambda record: record.found_at, reverse=True)
        step.offers_deleted.update(record.id for record in undecided[MAX_UNDECIDED:])


def open_entities(offers: Offers, types: Collection[str] = OFFERED_TYPES) -> set[str]:
    """Return the entities with an open offer."""
    return {record.entity for record in offers.listed(OfferStatus.OPEN) if record.type in types}


def _specification_faults(definition: TaskDefinition) -> Iterator[Fault]:
    if definition.specification is None:
        return
    values = definition.specification.value
    unknown = sorted(set(values) - set(FIELDS))
    try:
        Specification.of(values)
        why = f'it has an unknown field "{unknown[0]}"; there are {", ".join(FIELDS)}' if unknown else ""
    except ValueError as error:
        why = str(error)
    if why:
        yield _fault(
            message("offer.bad_specification", "the specification cannot be written: {why}", why=why)
        )


def _schema_faults(definition: TaskDefinition) -> Iterator[Fault]:
    if definition.work_parameters_schema is None:
        return
    schema = definition.work_parameters_schema.value
    if len(orjson.dumps(schema)) > MAX_SCHEMA_BYTES:
        yield _fault(
            message(
                "offer.schema_too_large",
                "workParametersSchema has more than {limit} bytes; make it smaller",
                limit=MAX_SCHEMA_BYTES,
            )
        )
    elif (fault := schema_fault(schema)) is not None:
        yield _fault(message("offer.bad_schema", "workParametersSchema is no JSON Schema: {why}", why=fault))


def _warnings_of(type_: str, content: Entity) -> Iterator[Fault]:
    if type_ == "Location" and position_of(content) is None:
        yield _fault(
            message(
                "offer.no_position",
                "it has no position, so distances to it are unknown; give it a location Point",
            )
        )
    if type_ != "ResourceSpecification":
        return
    for number, shift in enumerate(_listed(content, "shifts"), 1):
        if read_shift(shift) is None:
            yield _fault(
                message(
                    "offer.bad_shift",
                    "shift {number} cannot be read; it has weekday (1 to 7), from, to and a time zone",
                    number=number,
                )
            )
    for number, skill in enumerate(_listed(content, "skills"), 1):
        if skill_name(skill) is None:
            yield _fault(message("offer.bad_skill", "skill {number} has no name", number=number))


def _listed(content: Entity, attribute: str) -> list[Any]:
    declared = content.get(attribute)
    value = declared.get("value") if isinstance(declared, Mapping) else None
    return value if isinstance(value, list) else []


def _text(content: Entity, attribute: str) -> str | None:
    declared = content.get(attribute)
    value = declared.get("value") if isinstance(declared, Mapping) else declared
    return value if isinstance(value, str) else None


def _fault(text: str) -> Fault:
    return Fault(None, None, text)


def _too_large() -> str:
    return message(
        "offer.too_large",
        "the entity has more than {limit} bytes beside its BPMN file",
        limit=MAX_CONTENT_BYTES,
    )


def _changed_in_turn() -> str:
    return message(
        "offer.changed_in_turn",
        "the entity has had this content {times} times or more: several systems change it in turn",
        times=MANY_TIMES,
    )
