"""The outbox: one batch in flight per entity, bounded queues, and the newest update is never lost."""

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from handover_ros.rules.outbox import Batch, Outbox, Update


def update(rule: str, entity: str, value: Any, keep: int = 1) -> Update:
    return Update(rule, entity, "Device", {rule: {"type": "Property", "value": value}}, keep)


def test_updates_of_several_rules_for_one_entity_form_one_batch() -> None:
    outbox = Outbox()
    outbox.put(update("a", "e", 1))
    outbox.put(update("b", "e", 2))
    outbox.put(update("a", "f", 3))
    batches = outbox.take()
    assert [batch.entity_id for batch in batches] == ["e", "f"]
    assert batches[0].entities() == [
        {
            "id": "e",
            "type": "Device",
            "a": {"type": "Property", "value": 1},
            "b": {"type": "Property", "value": 2},
        }
    ]


def test_an_entity_has_one_batch_in_flight_and_the_newest_update_waits() -> None:
    outbox = Outbox()
    outbox.put(update("a", "e", 1))
    first = outbox.take()
    assert [outbox.put(update("a", "e", value)) for value in (2, 3)] == [0, 1]
    assert outbox.take() == []
    outbox.acknowledge(first)
    assert outbox.take()[0].updates == (update("a", "e", 3),)


def test_a_newer_update_replaces_a_requeued_one() -> None:
    outbox = Outbox()
    outbox.put(update("a", "e", 1))
    first = outbox.take()
    outbox.put(update("a", "e", 2))
    assert outbox.requeue(first) == {"a": 1}
    assert outbox.take()[0].updates == (update("a", "e", 2),)


def test_a_rule_with_keep_sends_its_versions_in_order() -> None:
    outbox = Outbox()
    replaced = [outbox.put(update("a", "e", value, keep=3)) for value in range(5)]
    assert replaced == [0, 0, 0, 1, 1]
    first = outbox.take()
    outbox.put(update("a", "e", 5, keep=3))
    assert outbox.requeue(first) == {"a": 1}, "a newer update replaces the oldest"
    (batch,) = outbox.take()
    assert [entity["a"]["value"] for entity in batch.entities()] == [3, 4, 5]
    outbox.acknowledge([batch])
    assert len(outbox) == 0


class AnyOrder(RuleBasedStateMachine):
    """Puts, takes, failures and acknowledgements in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.outbox = Outbox()
        self.in_flight: list[Batch] = []
        self.newest: dict[tuple[str, str], int] = {}
        self.arrived: dict[tuple[str, str], int] = {}
        self.number = 0

    @rule(entity=st.sampled_from("ef"), name=st.sampled_from("ab"))
    def put(self, entity: str, name: str) -> None:
        self.number += 1
        keep = 1 if name == "a" else 3
        self.outbox.put(update(name, entity, self.number, keep))
        self.newest[entity, name] = self.number

    @rule(max_entities=st.integers(1, 3))
    def take(self, max_entities: int) -> None:
        self.in_flight += self.outbox.take(max_entities)

    @rule(ok=st.booleans())
    def answer(self, ok: bool) -> None:
        if not self.in_flight:
            return
        batch = self.in_flight.pop(0)
        if not ok:
            self.outbox.requeue([batch])
            return
        self.outbox.acknowledge([batch])
        for one in batch.updates:
            value = one.attributes[one.rule]["value"]
            assert value > self.arrived.get((one.entity_id, one.rule), 0), "older after newer"
            self.arrived[one.entity_id, one.rule] = value

    @invariant()
    def one_under_way_for_each_entity(self) -> None:
        entities = [batch.entity_id for batch in self.in_flight]
        assert len(entities) == len(set(entities)) == self.outbox.in_flight
        assert len(self.outbox) <= 2 * (1 + 3)

    def teardown(self) -> None:
        self.outbox.requeue(self.in_flight)
        self.in_flight = []
        while batches := self.outbox.take():
            self.in_flight = batches
            while self.in_flight:
                self.answer(True)
        assert self.arrived == self.newest


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=60, deadline=None)
