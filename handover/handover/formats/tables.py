"""Tables as CSV (RFC 4180): UTF-8 with a byte order mark, which spreadsheets need."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def csv_table(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> bytes:
    """Return one line for each row; missing values are empty."""
    text = io.StringIO()
    lines = csv.writer(text)
    lines.writerow(columns)
    lines.writerows([_cell(row.get(column)) for column in columns] for row in rows)
    return f"\ufeff{text.getvalue()}".encode()


def _cell(value: Any) -> Any:
    """Return a text that a spreadsheet would run as a formula with a quote before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
