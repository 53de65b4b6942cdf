"""Tally: what one step adds to the statistics of processes, Tasks and resources.

How it works: a step counts each started and ended process, each ended Task and each interval of work. The
store adds the counts to two tables in the transaction of the step: by hour, by day (UTC) and by 30 days. A
query reads the longest rows that its period contains, and shorter ones at both ends, so that its cost depends
little on its length, and not on the number of stored processes, running or archived.

Durations go into logarithmic bins. A percentile is the mean of the bin that contains it; its error is below
the width of a bin, 9 %. Sums, and therefore means, are exact. All times are those of the orchestrator:
waiting, working and paused time of a Task add up to its duration, whatever the clocks of performers show.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from typing import Final

BINS_PER_DOUBLING: Final = 8
HOUR_MS: Final = 3_600_000
DAY_H: Final = 24
SPANS_H: Final = (1, DAY_H, 30 * DAY_H)
"""The hours of a row; each divides the next."""
MAX_RESOURCE_LENGTH: Final = 300
WHOLE_PROCESS: Final = ""
"""Stands for the process itself in the place of an element."""


Version = tuple[str, int]
"""A definition and its version."""


class Counted(StrEnum):
    """What is counted of a process or a Task."""

    STARTED = "started"
    """Only processes; it has no duration."""
    COMPLETED = "completed"
    FAILED = "failed"
    CANCELLED = "cancelled"
    """Only Tasks: the process has left the activity."""


@dataclass(frozen=True, slots=True)
class StatisticsKey:
    """A row of the statistics; `hour` counts from 1970 (UTC)."""

    hour: int
    definition: str
    version: int
    element: str
    result: Counted
    bin: int


@dataclass(slots=True)
class Sums:
    """The sums of a row."""

    counted: int = 0
    duration_ms: int = 0
    working_ms: int = 0
    paused_ms: int = 0

    def add(self, other: "Sums") -> None:
        """Add the sums of another row."""
        self.counted += other.counted
        self.duration_ms += other.duration_ms
        self.working_ms += other.working_ms
        self.paused_ms += other.paused_ms

    @property
    def waiting_ms(self) -> int:
        """Return the time until performers began, and between acceptance and begin."""
        return self.duration_ms - self.working_ms - self.paused_ms


@dataclass(frozen=True, slots=True)
class WorkKey:
    """A row of the work of resources."""

    hour: int
    resource: str
    definition: str
    version: int


@dataclass
class Tally:
    """The counts of one step, by hour."""

    statistics: dict[StatisticsKey, Sums] = field(default_factory=dict)
    work: dict[WorkKey, int] = field(default_factory=dict)
    """Working time in ms."""

    def add_start(self, of: Version, at: datetime) -> None:
        """Count the start of a process."""
        key = StatisticsKey(hour_of(at), *of, WHOLE_PROCESS, Counted.STARTED, 0)
        self.statistics.setdefault(key, Sums()).add(Sums(1))

    def add_end(
        self, of: Version, result: Counted, at: datetime, sums: Sums, element: str = WHOLE_PROCESS
    ) -> None:
        """Count the end of a process or, with `element`, of a Task, with its times."""
        key = StatisticsKey(hour_of(at), *of, element, result, bin_of(sums.duration_ms))
        self.statistics.setdefault(key, Sums()).add(sums)

    def add_work(self, of: Version, resource: str, begins: datetime, ends: datetime) -> None:
        """Count the time in which a resource worked on a Task; it is divided among the hours."""
        if len(resource) > MAX_RESOURCE_LENGTH:
            return
        for hour, worked_ms in split_by_hour(begins, ends):
            key = WorkKey(hour, resource, *of)
            self.work[key] = self.work.get(key, 0) + worked_ms


@dataclass(frozen=True, slots=True)
class Period:
    """The hours from `begins` to before `ends`, counted from 1970 (UTC)."""

    begins: int
    ends: int

    @property
    def begins_at(self) -> datetime:
        """Return the first moment."""
        return moment_of(self.begins)

    @property
    def ends_at(self) -> datetime:
        """Return the moment after the last one."""
        return moment_of(self.ends)

    def spans(self) -> Iterator[tuple[int, int, int]]:
        """Yield the rows to read as (hours of a row, first, end), the shorter ones at both ends."""
        yield from _spans(self.begins, self.ends, SPANS_H)


def _spans(begins: int, ends: int, lengths: Sequence[int]) -> Iterator[tuple[int, int, int]]:
    if begins >= ends:
        return
    *shorter, longest = lengths
    first, last = -(-begins // longest) * longest, ends // longest * longest
    if first >= last:
        yield from _spans(begins, ends, shorter)
        return
    yield from _spans(begins, first, shorter)
    yield longest, first, last
    yield from _spans(last, ends, shorter)


def milliseconds(moment: datetime) -> int:
    """Return a moment in ms since 1970."""
    return round(moment.timestamp() * 1000)


def elapsed_ms(begins: datetime, ends: datetime) -> int:
    """Return the time between two moments; 0 if the clock was set back meanwhile."""
    return max(0, milliseconds(ends) - milliseconds(begins))


def hour_of(moment: datetime) -> int:
    """Return the hour of a moment, counted from 1970 (UTC)."""
    return milliseconds(moment) // HOUR_MS


def split_by_hour(begins: datetime, ends: datetime) -> Iterator[tuple[int, int]]:
    """Yield the hours of an interval, each with the part of the interval in it in ms."""
    at, end = milliseconds(begins), milliseconds(ends)
    while at < end:
        hour = at // HOUR_MS
        until = min(end, (hour + 1) * HOUR_MS)
        yield hour, until - at
        at = until


def bin_of(duration_ms: int) -> int:
    """Return the bin of a duration: bin n > 0 begins at 2^((n - 1) / 8) ms."""
    return 0 if duration_ms < 1 else 1 + math.floor(math.log2(duration_ms) * BINS_PER_DOUBLING)


def moment_of(hour: int) -> datetime:
    """Return the moment at which an hour begins."""
    return datetime.fromtimestamp(hour * HOUR_MS / 1000, UTC)
