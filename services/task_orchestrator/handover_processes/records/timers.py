"""Timers: the moments at which a process acts or starts."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum


class TimerKind(StrEnum):
    """What a timer is for."""

    EVENT = "event"
    RETRY = "retry"
    ESCALATION = "escalation"
    DEADLINE = "deadline"
    GRACE = "grace"


@dataclass(frozen=True, slots=True)
class StartTimer:
    """A timer start event of the latest version of a definition; `text` is the cycle of a repeating one."""

    definition: str
    event: str
    due: datetime
    text: str | None = None
    count: int = 0
    """How often it was due."""


@dataclass(frozen=True, slots=True)
class Timer:
    """A moment at which a process has to act; `subject` is the id of a Task, a token, or empty."""

    kind: TimerKind
    subject: str
    due: datetime
