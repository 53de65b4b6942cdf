"""The due queue finds the same moments as a look at all of them."""

from datetime import timedelta

from hypothesis import given
from hypothesis import strategies as st

from handover_bpmn.timing.due_queue import DueQueue
from services.task_orchestrator.tests.unit.drawing import NOW

CHANGES = st.lists(st.tuples(st.integers(0, 9), st.none() | st.integers(0, 20)), max_size=200)


@given(CHANGES, st.integers(0, 20))
def test_the_earliest_and_all_due_moments_are_found(
    changes: list[tuple[int, int | None]], seconds: int
) -> None:
    queue, expected = DueQueue[int](), dict[int, int]()
    for key, due in changes:
        queue.set(key, None if due is None else NOW + timedelta(seconds=due))
        expected.pop(key, None)
        if due is not None:
            expected[key] = due
    earliest = min(expected.values(), default=None)
    assert queue.next_due() == (None if earliest is None else NOW + timedelta(seconds=earliest))
    due_keys = sorted((due, key) for key, due in expected.items() if due <= seconds)
    assert queue.due(NOW + timedelta(seconds=seconds)) == [key for _, key in due_keys]


def test_a_queue_of_one_key_stays_small() -> None:
    queue = DueQueue[str]()
    for second in range(10_000):
        queue.set("process", NOW + timedelta(seconds=10_000 - second))
    assert len(queue._heap) <= 1_010
