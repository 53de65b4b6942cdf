"""Offers: one for each content of an entity, superseded, withdrawn, open again, decided."""

from typing import Any

import pytest

from handover_processes.definitions.offer_rules import MAX_UNDECIDED, Candidate, Offers, read_candidate
from handover_processes.records.offers import Decision, OfferStatus
from handover_processes.records.step import Step
from services.task_orchestrator.tests.unit.drawing import NOW

DEFINITION = "urn:ngsi-ld:TaskDefinition:mes:pick"


def entity(type_: str = "TaskDefinition", **attributes: Any) -> dict[str, Any]:
    values = {name: {"type": "Property", "value": value} for name, value in attributes.items()}
    return {"id": f"urn:ngsi-ld:{type_}:mes:pick", "type": type_, "name": {"value": "Pick"}, **values}


def candidate(**attributes: Any) -> Candidate:
    found = read_candidate(entity(**attributes))
    assert found is not None
    return found


class Broker:
    """Offers, and the steps that change them."""

    def __init__(self) -> None:
        self.offers = Offers()

    def has(self, gesture: str) -> str:
        """Let the entity have a content; return the id of its offer."""
        step, found = Step(1), candidate(gesture=gesture)
        self.offers.receive(step, found, NOW)
        self.offers.apply(step)
        return found.id

    def decide(self, offer: str, status: OfferStatus) -> None:
        step = Step(1)
        self.offers.decide(step, offer, Decision(NOW, status, "Eva"))
        self.offers.apply(step)

    def states(self) -> dict[str, str]:
        return {each.content["gesture"]["value"]: each.status.value for each in self.offers.listed()}


def test_contents_that_alternate_are_two_offers_of_which_one_is_open() -> None:
    broker = Broker()
    for _ in range(5):
        for gesture in ("Horns", "Thumbs up"):
            last = broker.has(gesture)
    assert broker.states() == {"Horns": "superseded", "Thumbs up": "open"}
    offer = broker.offers.find(last)
    assert offer is not None
    assert offer.times == 5
    assert len(offer.warnings) == 1


def test_a_rejected_content_is_not_offered_again_and_an_accepted_one_stays_in_force() -> None:
    broker = Broker()
    broker.decide(broker.has("Horns"), OfferStatus.ACCEPTED)
    broker.decide(broker.has("Thumbs up"), OfferStatus.REJECTED)
    broker.has("Horns")
    broker.has("Thumbs up")
    assert broker.states() == {"Horns": "accepted", "Thumbs up": "rejected"}
    assert broker.offers.task_kinds()[DEFINITION].gesture == "Horns"


def test_an_accepted_content_that_was_replaced_is_offered_when_it_returns() -> None:
    broker = Broker()
    broker.decide(broker.has("Horns"), OfferStatus.ACCEPTED)
    broker.decide(broker.has("Thumbs up"), OfferStatus.ACCEPTED)
    broker.has("Horns")
    assert broker.states() == {"Horns": "open", "Thumbs up": "accepted"}
    assert broker.offers.task_kinds()[DEFINITION].gesture == "Thumbs up"


def test_undecided_offers_of_an_entity_are_limited() -> None:
    broker = Broker()
    for number in range(3 * MAX_UNDECIDED):
        broker.has(f"Gesture {number}")
    assert len(broker.offers.listed()) == MAX_UNDECIDED + 1


@pytest.mark.parametrize(
    ("attributes", "fault"),
    [
        ({"commandId": "many"}, "commandId"),
        ({"workParametersSchema": {"type": 7}}, "is no JSON Schema"),
        ({"workParametersSchema": {"description": "x" * 70_000}}, "more than 65536 bytes"),
        ({"description": "x" * 300_000}, "more than 262144 bytes"),
        ({"requiredSkills": [1]}, "requiredSkills"),
    ],
)
def test_what_is_wrong_with_a_definition_is_a_fault(attributes: dict[str, Any], fault: str) -> None:
    (found,) = candidate(**attributes).faults
    assert fault in str(found)


def test_other_attributes_do_not_make_another_offer() -> None:
    first = candidate(gesture="Horns")
    assert candidate(gesture="Horns", erpNumber=7).id == first.id
    assert candidate(gesture="Thumbs up").id != first.id


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"id": 7, "type": "Location"},
        {"id": "urn:x:y", "type": "Device"},
        {"id": "a\0", "type": "Location"},
    ],
)
def test_what_is_no_definition_is_no_candidate(wrong: dict[str, Any]) -> None:
    assert read_candidate(wrong) is None


def test_a_resource_is_used_until_it_is_rejected_or_once_it_is_accepted() -> None:
    offers = Offers()
    given = entity("ResourceSpecification", resourceType="robot", skills=["grip"])
    offers.foreign.add(given["id"])
    assert list(offers.effective([given], needs_acceptance=False)) == [given]
    assert list(offers.effective([given], needs_acceptance=True)) == []
    found = read_candidate(given)
    assert found is not None
    for status, is_used in ((OfferStatus.REJECTED, False), (OfferStatus.ACCEPTED, True)):
        step = Step(1)
        offers.receive(step, found, NOW)
        offers.decide(step, found.id, Decision(NOW, status, "Eva"))
        offers.apply(step)
        for needs_acceptance in (True, False):
            assert list(offers.effective([given], needs_acceptance=needs_acceptance)) == [given] * is_used
    changed = {**given, "skills": {"type": "Property", "value": ["weld"]}}
    (used,) = offers.effective([changed], needs_acceptance=True)
    assert used["skills"]["value"] == ["grip"]
