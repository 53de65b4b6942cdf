"""Responses that are files: tables for spreadsheets and event logs."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from fastapi import Response

from handover.formats.tables import csv_table


def csv_response(
    name: str, row_type: type[Any], rows: Sequence[Mapping[str, Any]], *, without: Collection[str] = ()
) -> Response:
    """Return rows of a typed dictionary as CSV; durations are the last columns."""
    members = sorted(row_type.__annotations__, key=lambda member: member.endswith("Ms"))
    columns = [member for member in members if member not in without]
    return file_response(f"{name}.csv", "text/csv; charset=utf-8", csv_table(columns, rows))


def file_response(name: str, media_type: str, content: bytes) -> Response:
    """Return a file that a browser stores under a name."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=media_type, headers=headers)
