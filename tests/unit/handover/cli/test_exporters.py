"""The history of a process as CSV and JSON."""

import csv
import io
import json
from typing import Any

from handover.cli.exporters import COLUMNS, csv_of, json_of

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
    assert header == list(COLUMNS)
    values = dict(zip(header, line, strict=True))
    assert values["process"] == "p-1"
    assert values["performer"] == "urn:ngsi-ld:Device:demo:glove-1"
    assert values["reason"] == 'not "good", said Anna'
    assert values["endedAt"] == ""


def test_text_that_a_spreadsheet_would_run_is_quoted() -> None:
    assert b"'=1+1" in csv_of(PROCESS)


def test_json_has_everything() -> None:
    assert json.loads(json_of(PROCESS)) == PROCESS
