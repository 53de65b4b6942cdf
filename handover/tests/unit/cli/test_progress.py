"""The progress on the terminal: each event is printed once, in plain words."""

from datetime import UTC, datetime, timedelta
from typing import Any

from handover_cell.progress import ProgressPrinter
from handover_datamodels.entities import Task

BEGAN = datetime(2026, 1, 1, 12, tzinfo=UTC)


def seen(
    name: str, status: str, at_s: float, asked: dict[str, Any], given: dict[str, Any] | None = None
) -> Task:
    resource = "glove-1" if "gesture" in asked else "ur10-1"
    observed = (BEGAN + timedelta(seconds=at_s)).isoformat()
    return Task.from_ngsild(
        {
            "id": f"urn:ngsi-ld:Task:demo:{name}",
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:d"},
            "involves": {
                "type": "Property",
                "value": [{"type": "Relationship", "object": f"urn:ngsi-ld:Device:demo:{resource}"}],
            },
            "status": {"type": "Property", "value": status, "observedAt": observed},
            "workParameters": {"type": "Property", "value": asked},
            **({"outputParameters": {"type": "Property", "value": given}} if given else {}),
        }
    )


CONFIRM = {"gesture": "Thumbs up", "commandId": 1, "description": "Confirm"}
SHOWN = {"gesture": "Thumbs up", "commandId": 1, "heldMs": 1520, "by": "gesture"}


def test_a_story_says_who_which_gesture_and_how_long_and_says_it_once() -> None:
    lines: list[str] = []
    progress = ProgressPrinter(BEGAN, lines.append)
    progress.update([seen("a", "pending", 0, CONFIRM)])
    progress.update([seen("a", "inProgress", 0.1, CONFIRM)])
    ended = [seen("a", "completed", 3, CONFIRM, SHOWN)]
    progress.update(ended)
    progress.update(ended)
    assert lines == [
        '   0.0 s  glove-1   is asked: "Confirm"; show Thumbs up',
        "   3.0 s  glove-1   showed Thumbs up for 1.5 s, 3.0 s after being asked",
    ]


def test_every_pause_is_printed() -> None:
    lines: list[str] = []
    progress = ProgressPrinter(BEGAN, lines.append)
    for at_s, status in enumerate(["pending", "inProgress", "paused", "inProgress", "paused", "inProgress"]):
        progress.update([seen("a", status, at_s, {"operation": "scan"})])
    assert [line.split(maxsplit=3)[-1] for line in lines] == [
        "takes over: scan", "pauses", "continues", "pauses", "continues",
    ]  # fmt: skip


def test_a_failure_is_printed_with_its_reason_and_the_summary_counts_people_and_robots() -> None:
    lines: list[str] = []
    progress = ProgressPrinter(BEGAN, lines.append)
    robot = {"operation": "pick"}
    progress.update([seen("a", "pending", 0, CONFIRM), seen("b", "pending", 3, robot)])
    progress.update(
        [
            seen("a", "completed", 3, CONFIRM, SHOWN),
            seen("b", "failed", 5, robot, {"reason": "the part slipped"}),
        ]
    )
    assert lines[-1].endswith("failed after 2.0 s: the part slipped")
    assert progress.summary() == (
        "2 Tasks: 1 by the operator with 1 different gestures in 3.0 s, 1 by the robot in 2.0 s"
    )


def test_another_outcome_than_ok_is_printed_with_its_note() -> None:
    lines: list[str] = []
    progress = ProgressPrinter(BEGAN, lines.append)
    shown = {"gesture": "Horns", "heldMs": 1520, "by": "gesture", "outcome": "notGood"}
    pressed = {"heldMs": 0, "by": "screen", "operator": "Anna", "outcome": "problem", "note": "oil"}
    progress.update([seen("a", "pending", 0, CONFIRM), seen("b", "pending", 0, CONFIRM)])
    progress.update([seen("a", "completed", 3, CONFIRM, shown), seen("b", "failed", 4, CONFIRM, pressed)])
    assert [line.split("glove-1   ")[1] for line in lines[2:]] == [
        'answered "not good" with Horns after 3.0 s',
        'answered "problem" on the screen after 4.0 s: oil',
    ]
    assert progress.summary().startswith("2 Tasks: 2 by the operator with 1 different gestures")
