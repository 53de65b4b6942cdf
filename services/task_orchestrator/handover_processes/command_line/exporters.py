"""Exporters: the history of a process as a file; `handover process export` chooses one by name.

An exporter is a function that takes the process as `GET /processes/{process}` of the orchestrator returns it,
and returns the content of the file. Other packages register theirs in the group `handover.exporters`.
"""

from collections.abc import Callable, Mapping
from typing import Any

import orjson

from handover.extensions import ExtensionPoint
from handover.formats.tables import csv_table
from handover.tasks.event_log import TASK_COLUMNS, task_rows, xes_log

Exporter = Callable[[Mapping[str, Any]], bytes]

EXPORTERS = ExtensionPoint(
    "exporter",
    "handover.exporters",
    {
        "csv": "handover_processes.command_line.exporters:csv_of",
        "json": "handover_processes.command_line.exporters:json_of",
        "xes": "handover_processes.command_line.exporters:xes_of",
    },
)


def json_of(process: Mapping[str, Any]) -> bytes:
    """Return everything about the process as JSON."""
    return orjson.dumps(process, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def csv_of(process: Mapping[str, Any]) -> bytes:
    """Return one line for each Task."""
    return csv_table(TASK_COLUMNS, task_rows(process))


def xes_of(process: Mapping[str, Any]) -> bytes:
    """Return the process as a log of one trace for process mining (XES, IEEE 1849-2016)."""
    return xes_log(f"{process['definition']} version {process['version']}", [process])
