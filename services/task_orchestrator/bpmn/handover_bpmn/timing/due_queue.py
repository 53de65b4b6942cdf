"""Due queue: moments by key, of which the earliest is found without looking at all."""

from datetime import datetime
from heapq import heapify, heappop, heappush
from typing import Generic, TypeVar

MIN_ENTRIES = 1000
"""Entries that may be out of date before the queue is built again."""

K = TypeVar("K", str, int)


class DueQueue(Generic[K]):
    """A heap of moments; entries that are out of date are removed when they come first, or are too many."""

    __slots__ = ("_dues", "_heap")

    def __init__(self) -> None:
        self._dues: dict[K, datetime] = {}
        self._heap: list[tuple[datetime, K]] = []

    def __contains__(self, key: K) -> bool:
        return key in self._dues

    def set(self, key: K, due: datetime | None) -> None:
        """Set the moment of a key; None removes it."""
        if due is None:
            self._dues.pop(key, None)
            return
        if self._dues.get(key) == due:
            return
        self._dues[key] = due
        heappush(self._heap, (due, key))
        if len(self._heap) > 2 * len(self._dues) + MIN_ENTRIES:
            self._heap = [(due, key) for key, due in self._dues.items()]
            heapify(self._heap)

    def next_due(self) -> datetime | None:
        """Return the earliest moment."""
        while self._heap and self._dues.get(self._heap[0][1]) != self._heap[0][0]:
            heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def first_due(self, now: datetime) -> K | None:
        """Return the key whose moment is the earliest, if that is `now` or earlier."""
        earliest = self.next_due()
        return None if earliest is None or earliest > now else self._heap[0][1]

    def due(self, now: datetime) -> list[K]:
        """Return the keys whose moment is `now` or earlier, the earliest first; they stay in the queue."""
        entries: list[tuple[datetime, K]] = []
        positions = [0]
        while positions:  # an entry of a heap is never later than those at 2n + 1 and 2n + 2
            position = positions.pop()
            if position < len(self._heap) and self._heap[position][0] <= now:
                due, key = self._heap[position]
                if self._dues.get(key) == due:
                    entries.append((due, key))
                positions += (2 * position + 1, 2 * position + 2)
        return list(dict.fromkeys(key for _, key in sorted(entries)))
