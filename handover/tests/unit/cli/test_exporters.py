"""The history of a process as CSV, JSON and XES."""

import csv
import io
import json
from typing import Any

from lxml import etree

from handover.tasks.event_log import TASK_COLUMNS, XES
from handover_processes.command_line.exporters import csv_of, json_of, xes_of

TASK: dict[str, Any] = {
    "id": "urn:ngsi-ld:Task:demo:1",
    "element": "check",
    "name": "=1+1",
    "visit": 1,
    "status": "failed",
    "involves": ["urn:ngsi-ld:Device:demo:glove-1"],
    "createdAt": "2026-01-01T12:00:00Z",
    "endedAt": None,
    "reason": 'not "good", said Anna',
    "history": [],
}
PROCESS = {"id": "p-1", "tasks": [TASK]}


def test_csv_has_a_line_for_each_task() -> None:
    header, line = csv.reader(io.StringIO(csv_of(PROCESS).decode("utf-8-sig")))
    assert header == list(TASK_COLUMNS)
    values = dict(zip(header, line, strict=True))
    assert values["process"] == "p-1"
    assert values["performer"] == "urn:ngsi-ld:Device:demo:glove-1"
    assert values["reason"] == 'not "good", said Anna'
    assert values["endedAt"] == ""


def test_text_that_a_spreadsheet_would_run_is_quoted() -> None:
    assert b"'=1+1" in csv_of(PROCESS)


def test_json_has_everything() -> None:
    assert json.loads(json_of(PROCESS)) == PROCESS


def test_xes_has_an_event_for_each_change_in_the_order_of_time() -> None:
    history = [
        {"status": "assigned", "at": "2026-01-01T12:00:01Z"},
        {"status": "inProgress", "at": "2026-01-01T12:00:02Z"},
        {"status": "paused", "at": "2026-01-01T12:00:05Z"},
        {"status": "inProgress", "at": "2026-01-01T12:00:06Z"},
        {"status": "completed", "at": "2026-01-01T12:00:09Z"},
    ]
    done = {**TASK, "name": "Check", "status": "completed", "cancelled": False, "history": history}
    called_back = {
        **TASK,
        "name": "Wait",
        "createdAt": "2026-01-01T12:00:03Z",
        "cancelled": True,
        "history": [{"status": "failed", "at": "2026-01-01T12:00:04Z"}],
    }
    process = {"id": "p-1", "definition": "p", "version": 2, "tasks": [done, called_back]}
    log = etree.fromstring(xes_of(process))
    assert log.tag == f"{{{XES}}}log"
    (trace,) = log.findall(f"{{{XES}}}trace")
    events = [
        {each.get("key"): each.get("value") for each in event} for event in trace.findall(f"{{{XES}}}event")
    ]
    assert [(event["concept:name"], event["lifecycle:transition"]) for event in events] == [
        ("Check", "schedule"),
        ("Check", "assign"),
        ("Check", "start"),
        ("Wait", "schedule"),
        ("Wait", "pi_abort"),
        ("Check", "suspend"),
        ("Check", "resume"),
        ("Check", "complete"),
    ]
    assert {event["org:resource"] for event in events} == {"urn:ngsi-ld:Device:demo:glove-1"}
    assert [event["time:timestamp"] for event in events] == sorted(
        event["time:timestamp"] for event in events
    )
