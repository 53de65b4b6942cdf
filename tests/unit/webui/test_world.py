"""The world and its readers: what a page ends up with, however slowly it reads."""

from typing import Any

import orjson
from hypothesis import given
from hypothesis import strategies as st

from webui.world import READER_EVENTS, Reader, World

TOPICS = ["services", "glove/glove-1", "process/p-1", "robot/ur10-1", "robot/ur10-1/joints"]
JOINTS = "robot/ur10-1/joints"


class Page:
    """What a browser keeps: the newest value of each topic, and the events by their number."""

    def __init__(self, world: World) -> None:
        self.topics: dict[str, Any] = {}
        self.events: list[int] = []
        self.news = 0
        self.reader: Reader = world.open_reader(self.told)

    def told(self) -> None:
        self.news += 1

    def read(self) -> dict[str, Any]:
        batch: dict[str, Any] = orjson.loads(self.reader.take("now"))
        if batch["type"] == "snapshot":
            self.topics.clear()
        for topic, value in batch["topics"].items():
            if value is None:
                self.topics.pop(topic, None)
            else:
                self.topics[topic] = value
        self.events += [event["seq"] for event in batch["events"]]
        return batch


def test_a_page_begins_with_everything() -> None:
    world = World()
    world.tell("services", [1])
    world.tell("process/p-1", {"id": "p-1"})
    world.happened(1, {"seq": 1})
    page = Page(world)
    world.tell("services", [2])
    first = page.read()
    assert first["type"] == "snapshot"
    assert page.topics == {"services": [2], "process/p-1": {"id": "p-1"}}
    assert page.events == [1]
    assert page.read() == {"type": "batch", "at": "now", "topics": {}, "events": []}


def test_of_a_topic_only_the_newest_value_is_sent() -> None:
    world = World()
    page = Page(world)
    page.read()
    for value in range(100):
        world.tell("services", [value])
    assert page.read()["topics"] == {"services": [99]}
    assert page.reader.overtaken == 99


def test_what_has_not_changed_is_not_sent_again() -> None:
    world = World()
    page = Page(world)
    page.read()
    assert world.tell("services", [1])
    page.read()
    heard = page.news
    assert not world.tell("services", [1])
    assert page.news == heard
    assert page.read()["topics"] == {}


def test_what_is_gone_is_said_to_be_gone() -> None:
    world = World()
    world.tell("process/p-1", {"id": "p-1"})
    page = Page(world)
    page.read()
    world.forget("process/p-1")
    assert page.read()["topics"] == {"process/p-1": None}
    world.forget("process/p-1")
    assert page.read()["topics"] == {}


def test_joints_go_only_to_the_page_that_wants_them() -> None:
    world = World()
    world.tell(JOINTS, {"stamp": 0})
    eager, calm = Page(world), Page(world)
    assert JOINTS not in eager.read()["topics"]
    calm.read()
    eager.reader.want([JOINTS])
    assert eager.read()["topics"] == {JOINTS: {"stamp": 0}}
    world.tell(JOINTS, {"stamp": 1})
    assert eager.read()["topics"] == {JOINTS: {"stamp": 1}}
    assert calm.read()["topics"] == {}
    eager.reader.want([])
    world.tell(JOINTS, {"stamp": 2})
    assert eager.read()["topics"] == {}


def test_a_page_cannot_want_what_everybody_gets() -> None:
    page = Page(World())
    page.reader.want(["services", "anything"])
    assert page.reader.wanted == frozenset()


def test_events_are_never_coalesced_and_a_gap_shows_in_their_numbers() -> None:
    world = World()
    page = Page(world)
    page.read()
    for seq in range(1, READER_EVENTS + 101):
        world.happened(seq, {"seq": seq})
    page.read()
    assert page.events == list(range(101, READER_EVENTS + 101))


def test_a_page_that_has_left_is_not_told() -> None:
    world = World()
    page = Page(world)
    page.read()
    world.close_reader(page.reader)
    world.tell("services", [1])
    assert page.news == 0


step = st.one_of(
    st.tuples(st.just("tell"), st.sampled_from(TOPICS), st.integers(0, 3)),
    st.tuples(st.just("forget"), st.sampled_from(TOPICS), st.none()),
    st.tuples(st.just("event"), st.none(), st.none()),
    st.tuples(st.just("read"), st.integers(0, 2), st.none()),
    st.tuples(st.just("want"), st.integers(0, 2), st.booleans()),
)


@given(st.lists(step, max_size=60))
def test_whatever_is_told_and_whenever_it_is_read_a_page_ends_up_knowing_the_world(steps: list[Any]) -> None:
    world = World()
    pages = [Page(world) for _ in range(3)]
    seq = 0
    for act, which, value in steps:
        if act == "tell":
            world.tell(which, {"value": value})
        elif act == "forget":
            world.forget(which)
        elif act == "event":
            seq += 1
            world.happened(seq, {"seq": seq})
        elif act == "read":
            pages[which].read()
        else:
            pages[which].reader.want([JOINTS] if value else [])
            if not value:
                pages[which].topics.pop(JOINTS, None)  # as a browser does when it stops wanting
    for page in pages:
        page.read()
        shown = set(TOPICS) if JOINTS in page.reader.wanted else set(TOPICS) - {JOINTS}
        assert page.topics == {topic: world.value(topic) for topic in shown if world.value(topic) is not None}
        assert page.events == list(range(1, seq + 1))
