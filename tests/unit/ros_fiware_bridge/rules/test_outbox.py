"""The outbox: one request under way for each entity, the newest never lost, and nothing without end."""

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from ros_fiware_bridge.rules.outbox import Letter, Outbox, Parcel


def letter(rule: str, entity: str, value: Any, keep: int = 1) -> Letter:
    return Letter(rule, entity, "Device", {rule: {"type": "Property", "value": value}}, keep)


def test_letters_of_several_rules_about_one_entity_go_together() -> None:
    outbox = Outbox()
    outbox.put(letter("a", "e", 1))
    outbox.put(letter("b", "e", 2))
    outbox.put(letter("a", "f", 3))
    parcels = outbox.take()
    assert [parcel.entity_id for parcel in parcels] == ["e", "f"]
    assert parcels[0].entities() == [
        {
            "id": "e",
            "type": "Device",
            "a": {"type": "Property", "value": 1},
            "b": {"type": "Property", "value": 2},
        }
    ]


def test_while_one_is_under_way_the_next_waits_and_the_newest_wins() -> None:
    outbox = Outbox()
    outbox.put(letter("a", "e", 1))
    first = outbox.take()
    assert [outbox.put(letter("a", "e", value)) for value in (2, 3)] == [0, 1]
    assert outbox.take() == []
    outbox.arrived(first)
    assert outbox.take()[0].letters == (letter("a", "e", 3),)


def test_what_comes_back_gives_way_to_what_is_newer() -> None:
    outbox = Outbox()
    outbox.put(letter("a", "e", 1))
    first = outbox.take()
    outbox.put(letter("a", "e", 2))
    assert outbox.came_back(first) == {"a": 1}
    assert outbox.take()[0].letters == (letter("a", "e", 2),)


def test_a_rule_that_keeps_some_sends_them_in_order() -> None:
    outbox = Outbox()
    gone = [outbox.put(letter("a", "e", value, keep=3)) for value in range(5)]
    assert gone == [0, 0, 0, 1, 1]
    first = outbox.take()
    outbox.put(letter("a", "e", 5, keep=3))
    assert outbox.came_back(first) == {"a": 1}, "the oldest gives way to what has come meanwhile"
    (parcel,) = outbox.take()
    assert [entity["a"]["value"] for entity in parcel.entities()] == [3, 4, 5]
    outbox.arrived([parcel])
    assert len(outbox) == 0


class AnyOrder(RuleBasedStateMachine):
    """Whatever is put, taken, lost and delivered, in whatever order."""

    def __init__(self) -> None:
        super().__init__()
        self.outbox = Outbox()
        self.under_way: list[Parcel] = []
        self.newest: dict[tuple[str, str], int] = {}
        self.arrived: dict[tuple[str, str], int] = {}
        self.number = 0

    @rule(entity=st.sampled_from("ef"), name=st.sampled_from("ab"))
    def put(self, entity: str, name: str) -> None:
        self.number += 1
        keep = 1 if name == "a" else 3
        self.outbox.put(letter(name, entity, self.number, keep))
        self.newest[entity, name] = self.number

    @rule(most=st.integers(1, 3))
    def take(self, most: int) -> None:
        self.under_way += self.outbox.take(most)

    @rule(ok=st.booleans())
    def answer(self, ok: bool) -> None:
        if not self.under_way:
            return
        parcel = self.under_way.pop(0)
        if not ok:
            self.outbox.came_back([parcel])
            return
        self.outbox.arrived([parcel])
        for one in parcel.letters:
            value = one.attributes[one.rule]["value"]
            assert value > self.arrived.get((one.entity_id, one.rule), 0), "older after newer"
            self.arrived[one.entity_id, one.rule] = value

    @invariant()
    def one_under_way_for_each_entity(self) -> None:
        entities = [parcel.entity_id for parcel in self.under_way]
        assert len(entities) == len(set(entities)) == self.outbox.under_way
        assert len(self.outbox) <= 2 * (1 + 3)

    def teardown(self) -> None:
        self.outbox.came_back(self.under_way)
        self.under_way = []
        while parcels := self.outbox.take():
            self.under_way = parcels
            while self.under_way:
                self.answer(True)
        assert self.arrived == self.newest


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=60, deadline=None)
