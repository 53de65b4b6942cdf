"""The same warning again and again, as one line: a service that retries each second does not fill the disk.

The first line is written at once. Equal ones are counted for `PAUSE_S`; the next one after that has their
number as `repeated`. Lines are equal with the same level, text and fields. An error in a field, and a
traceback, counts by its first line, in which numbers may differ (ports, times, addresses).
"""

import logging
import re
import sys
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

PAUSE_S: Final = 600.0
MAX_REMEMBERED: Final = 1000
REPEATED: Final = "repeated"
_NUMBER: Final = re.compile(r"0x[0-9a-f]+|\d+")
_ERRORS: Final = frozenset({"error", "reason"})
_UNCOMPARED: Final = frozenset({"timestamp"})

Key = tuple[str, ...]


@dataclass(slots=True)
class _Repeated:
    since_s: float
    count: int = 0


class RepeatedLines(logging.Filter):
    """Drops warnings and errors that repeat one of the last minutes. `clock` returns seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._known: OrderedDict[Key, _Repeated] = OrderedDict()
        self._lock = Lock()

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether `record` is written, with the number of those dropped before it."""
        if record.levelno < logging.WARNING:
            return True
        key, now_s = _key_of(record), self._clock()
        with self._lock:
            line = self._known.get(key)
            if line is not None and now_s - line.since_s < PAUSE_S:
                line.count += 1
                return False
            self._known[key] = _Repeated(now_s)
            self._known.move_to_end(key)
            if len(self._known) > MAX_REMEMBERED:
                self._known.popitem(last=False)
        if line is not None and line.count:
            if isinstance(record.msg, dict):
                record.msg[REPEATED] = line.count
            else:
                setattr(record, REPEATED, line.count)
        return True


def _key_of(record: logging.LogRecord) -> Key:
    """Return what makes `record` equal to another; structlog's have a dictionary as their message."""
    if not isinstance(record.msg, dict):
        return (record.name, record.levelname, record.getMessage(), _kind_of(record.exc_info))
    fields = (
        f"{name}={_text_of(name, value)}"
        for name, value in sorted(record.msg.items())
        if name not in _UNCOMPARED
    )
    return (record.name, record.levelname, *fields)


def _text_of(name: str, value: Any) -> str:
    if name == "exc_info":
        return _kind_of(value)
    return _first_line(value) if name in _ERRORS else str(value)


def _kind_of(exc_info: Any) -> str:
    if exc_info is True:
        exc_info = sys.exc_info()
    error = exc_info[1] if isinstance(exc_info, tuple) else exc_info
    return f"{type(error).__qualname__} {_first_line(error)}" if isinstance(error, BaseException) else ""


def _first_line(value: Any) -> str:
    return _NUMBER.sub("#", str(value).strip().partition("\n")[0])
