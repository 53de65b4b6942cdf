"""Exporters: the history of a process as a file; `handover process export` chooses one by name.

An exporter is a function that takes the process as `GET /processes/{process}` of the orchestrator returns it,
and returns the content of the file. Other packages register theirs in the group `handover.exporters`.
"""

import csv
import io
from collections.abc import Callable, Mapping
from typing import Any

import orjson

from handover.extensions import ExtensionPoint

Exporter = Callable[[Mapping[str, Any]], bytes]

EXPORTERS = ExtensionPoint(
    "exporter",
    "handover.exporters",
    {"csv": "handover.cli.exporters:csv_of", "json": "handover.cli.exporters:json_of"},
)
COLUMNS = (
    "process",
    "task",
    "element",
    "name",
    "visit",
    "performer",
    "status",
    "createdAt",
    "endedAt",
    "reason",
)
FORMULA = ("=", "+", "-", "@", "\t", "\r")


def json_of(process: Mapping[str, Any]) -> bytes:
    """Return everything about the process as JSON."""
    return orjson.dumps(process, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_of(process: Mapping[str, Any]) -> bytes:
    """Return one line for each Task (RFC 4180, UTF-8 with a byte order mark for spreadsheets)."""
    text = io.StringIO()
    lines = csv.writer(text)
    lines.writerow(COLUMNS)
    for task in process["tasks"]:
        values = {
            **task,
            "process": process["id"],
            "task": task["id"],
            "performer": " ".join(task["involves"]),
        }
        lines.writerow([_cell(values.get(column)) for column in COLUMNS])
    return f"\ufeff{text.getvalue()}".encode()


def _cell(value: Any) -> Any:
    """Return a text that a spreadsheet would run as a formula with a quote before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
