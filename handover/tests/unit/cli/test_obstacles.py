"""What the demo says when its process cannot go on by itself."""

from typing import Any

import pytest

from handover_cell.obstacles import obstacle

INCIDENT = {"token": "6", "element": "scan", "name": "Scan the bin", "reason": "there is no bin"}
HELD = {"reason": "ur10-1 is held by other-1", "reasonParameters": {"process": "other-1"}}


def process(name: str = "mine-1", **changes: Any) -> dict[str, Any]:
    return {"id": name, "incidents": [], "unallocated": [], **changes}


@pytest.mark.parametrize(
    ("waiting", "holder", "words"),
    [
        (process(), {}, None),
        ({}, {}, None),
        (process(incidents=[INCIDENT]), {}, "retry mine-1 6"),
        (process(unallocated=[HELD]), process("other-1"), None),
        (process(unallocated=[HELD]), {}, None),
        (process(unallocated=[HELD]), process("other-1", incidents=[INCIDENT]), "retry other-1 6"),
        (process(unallocated=[{"reason": "nobody can", "reasonParameters": {}}]), {}, None),
    ],
)
async def test_only_what_waits_for_a_person_is_an_obstacle(
    waiting: dict[str, Any], holder: dict[str, Any], words: str | None
) -> None:
    async def find(name: str) -> dict[str, Any]:
        assert name == "other-1"
        return holder

    found = await obstacle(waiting, find, "handover")
    assert found is None if words is None else words in str(found)
