"""The live state and its viewers: every page converges, however slowly it reads."""

from typing import Any

import orjson
from hypothesis import given
from hypothesis import strategies as st

from handover_web.live.live_state import MAX_PENDING_EVENTS, LiveState, Reader, Viewer

TOPICS = ["services", "glove/glove-1", "process/p-1", "robot/ur10-1", "robot/ur10-1/joints"]
JOINTS = "robot/ur10-1/joints"


class Page:
    """The state of a page in a browser: the newest value of each topic, and the events by `seq`."""

    def __init__(self, state: LiveState, reader: Reader | None = None) -> None:
        self.topics: dict[str, Any] = {}
        self.events: list[int] = []
        self.changes = 0
        self.viewer: Viewer = state.add_viewer(self.on_change, reader)

    def on_change(self) -> None:
        self.changes += 1

    def read(self) -> dict[str, Any]:
        batch: dict[str, Any] = orjson.loads(self.viewer.next_message("now"))
        if batch["type"] == "snapshot":
            self.topics.clear()
        for topic, value in batch["topics"].items():
            if value is None:
                self.topics.pop(topic, None)
            else:
                self.topics[topic] = value
        self.events += [event["seq"] for event in batch["events"]]
        return batch


def test_the_first_message_is_a_snapshot() -> None:
    state = LiveState()
    state.publish("services", [1])
    state.publish("process/p-1", {"id": "p-1"})
    state.publish_event(1, {"seq": 1})
    page = Page(state)
    state.publish("services", [2])
    first = page.read()
    assert first["type"] == "snapshot"
    assert page.topics == {"services": [2], "process/p-1": {"id": "p-1"}}
    assert page.events == [1]
    assert page.read() == {"type": "batch", "at": "now", "topics": {}, "events": []}


def test_only_the_newest_value_of_a_topic_is_sent() -> None:
    state = LiveState()
    page = Page(state)
    page.read()
    for value in range(100):
        state.publish("services", [value])
    assert page.read()["topics"] == {"services": [99]}
    assert page.viewer.coalesced_count == 99


def test_unchanged_values_are_not_sent_again() -> None:
    state = LiveState()
    page = Page(state)
    page.read()
    assert state.publish("services", [1])
    page.read()
    changes = page.changes
    assert not state.publish("services", [1])
    assert page.changes == changes
    assert page.read()["topics"] == {}


def test_deleted_topics_are_sent_as_null() -> None:
    state = LiveState()
    state.publish("process/p-1", {"id": "p-1"})
    page = Page(state)
    page.read()
    state.remove("process/p-1")
    assert page.read()["topics"] == {"process/p-1": None}
    state.remove("process/p-1")
    assert page.read()["topics"] == {}


def test_joints_are_sent_to_subscribed_pages_only() -> None:
    state = LiveState()
    state.publish(JOINTS, {"stamp": 0})
    subscribed, other = Page(state), Page(state)
    assert JOINTS not in subscribed.read()["topics"]
    other.read()
    subscribed.viewer.subscribe([JOINTS])
    assert subscribed.read()["topics"] == {JOINTS: {"stamp": 0}}
    state.publish(JOINTS, {"stamp": 1})
    assert subscribed.read()["topics"] == {JOINTS: {"stamp": 1}}
    assert other.read()["topics"] == {}
    subscribed.viewer.subscribe([])
    state.publish(JOINTS, {"stamp": 2})
    assert subscribed.read()["topics"] == {}


def test_one_subscription_brings_all_registered_devices() -> None:
    state = LiveState()
    state.publish("registeredDevice/a", 1)
    page, other = Page(state), Page(state)
    assert page.read()["topics"] == other.read()["topics"] == {}
    page.viewer.subscribe(["registeredDevices"])
    assert page.read()["topics"] == {"registeredDevice/a": 1}
    state.publish("registeredDevices", {"isCurrent": True})
    state.publish("registeredDevice/b", 2)
    assert page.read()["topics"] == {"registeredDevices": {"isCurrent": True}, "registeredDevice/b": 2}
    state.publish("registeredDevice/b", 3)
    page.viewer.subscribe([])
    assert page.read()["topics"] == other.read()["topics"] == {}


def test_a_subscription_to_the_pulse_wakes_its_sender_and_brings_no_value() -> None:
    page = Page(LiveState())
    page.read()
    page.changes = 0
    page.viewer.subscribe(["pulse"])
    assert page.changes == 1
    assert page.read()["topics"] == {}


def test_a_page_receives_only_devices_that_its_user_may_read() -> None:
    state = LiveState()
    for name in ("a", "b"):
        state.publish(f"device/{name}", name)
        state.publish(f"registeredDevice/{name}", name)
    state.publish("services", [1])
    reader = Reader(lambda entity: entity == "a")
    page = Page(state, reader)
    page.viewer.subscribe(["registeredDevices"])
    page.read()
    assert page.topics == {"device/a": "a", "registeredDevice/a": "a", "services": [1]}
    state.publish("device/b", "changed")
    state.remove("registeredDevice/b")
    assert page.read()["topics"] == {}
    reader.change(lambda entity: entity == "b")
    assert page.read()["type"] == "snapshot"
    assert page.topics == {"device/b": "changed", "services": [1]}


def test_subscriptions_to_other_topics_are_ignored() -> None:
    page = Page(LiveState())
    page.viewer.subscribe(["services", "anything"])
    assert page.viewer.subscribed == frozenset()


def test_events_are_not_coalesced_and_dropped_events_leave_a_gap() -> None:
    state = LiveState()
    page = Page(state)
    page.read()
    for seq in range(1, MAX_PENDING_EVENTS + 101):
        state.publish_event(seq, {"seq": seq})
    page.read()
    assert page.events == list(range(101, MAX_PENDING_EVENTS + 101))


def test_removed_viewers_are_not_notified() -> None:
    state = LiveState()
    page = Page(state)
    page.read()
    state.remove_viewer(page.viewer)
    state.publish("services", [1])
    assert page.changes == 0


def test_a_page_receives_nothing_of_a_robot_that_its_user_may_not_read() -> None:
    state, mine, other = LiveState(), ("robot-1", "anna"), ("robot-2", "*")
    page = Page(state, Reader(set(mine).__contains__))
    everything = Page(state)

    def publish(value: int) -> None:
        state.publish("robot/robot-1", {"value": value}, mine)
        state.publish("robot/robot-2", {"value": value}, other)
        state.publish("services", [{"text": f"robot-2: {value}"}], partial=[{"text": None}])
        state.publish("cell", {"value": value})
        state.publish_event(value, {"seq": value})

    publish(1)
    for value in (2, 3):
        page.read()
        everything.read()
        assert set(page.topics) == {"robot/robot-1", "services", "cell"}
        assert page.topics["services"] == [{"text": None}]
        assert page.events == []
        assert "robot/robot-2" in everything.topics
        publish(value)
    state.publish("robot/robot-1", {"value": 4}, other)
    state.remove("robot/robot-2")
    page.read()
    everything.read()
    assert "robot/robot-1" not in page.topics, "it is about another resource now"
    assert everything.topics["robot/robot-1"] == {"value": 4}
    assert everything.events == [1, 2, 3]


step = st.one_of(
    st.tuples(st.just("publish"), st.sampled_from(TOPICS), st.integers(0, 3)),
    st.tuples(st.just("remove"), st.sampled_from(TOPICS), st.none()),
    st.tuples(st.just("event"), st.none(), st.none()),
    st.tuples(st.just("read"), st.integers(0, 2), st.none()),
    st.tuples(st.just("subscribe"), st.integers(0, 2), st.booleans()),
)


@given(st.lists(step, max_size=60))
def test_every_page_converges_to_the_live_state(steps: list[Any]) -> None:
    state = LiveState()
    pages = [Page(state) for _ in range(3)]
    seq = 0
    for act, which, value in steps:
        if act == "publish":
            state.publish(which, {"value": value})
        elif act == "remove":
            state.remove(which)
        elif act == "event":
            seq += 1
            state.publish_event(seq, {"seq": seq})
        elif act == "read":
            pages[which].read()
        else:
            pages[which].viewer.subscribe([JOINTS] if value else [])
            if not value:
                pages[which].topics.pop(JOINTS, None)  # as the page does when it unsubscribes
    for page in pages:
        page.read()
        shown = set(TOPICS) if JOINTS in page.viewer.subscribed else set(TOPICS) - {JOINTS}
        assert page.topics == {topic: state.value(topic) for topic in shown if state.value(topic) is not None}
        assert page.events == list(range(1, seq + 1))
